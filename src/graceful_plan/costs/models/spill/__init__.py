r"""The spill model: whom contents reach if they are dropped here, get out in the gripper, or if the robot stops here.

Contents leave over the rim, come down on something, run out to a puddle as deep as surface tension lets it be (dry
contents to a heap), reach what stands in it, and run over the edges of what carries it to what is below. What the drop
model says about where the container comes down serves for both uses, `USES`: contents that get out in the gripper come
down on the same things, at a less certain place.

"dropped" is P(contents reach the entity | the gripper lets go); a soft landing spills nothing. "held" is P(contents
reach the entity | contents get out while the gripper holds). How likely that is does not show in the state (fits to
speed and tilt explain less than 1 % of the variance), so it is left to the prior over faults.

"stopped" is P(contents reach the entity | the robot stops by itself). That does show in the state: a robot that brakes
throws contents forward, and how fast it moves, how long it needs to stop and how full and tilted the container is
tell whether they go over the rim. They leave with the velocity that the rim had. What they felt before the stop, and
waves of the surface beyond a constant factor, are left out.

Hot contents: severities have columns for hot contents already, so that nothing here depends on the temperature.

Specification
-------------
Symbols, functions and the drop model's results as in the docstring of `graceful_plan.costs.models.drop`; F_l, M_l: sums
over a level; tc_l: tc of its first target; Z_l: its top. Constants, for each use: `SpillConstants`. Tables:
`SpillTables`. The native kernel (native/impact/contents) follows this text.

.. code-block:: text

    Contents
      o = R mouth;  m = c + o;  vm = v + w x o;  sm2 = vmx^2 + vmy^2;  z = (R axis)_z;  p = (z + sqrt(z^2 + 0.01))/2
      lean = max(0, sqrt(1.0051 - p^2)/p - repose) + kv sqrt(sm2 + 1e-4);  x = r lean/H
      fill = (1 + x + x^2 + 1.7 x^3)/full        what it could hold at this tilt is 1/fill of what was in it
      rho = R (1 + fill^4)^(-power/4)            radius of a puddle of what is in it
      s = sqrt(s0^2 + (cr r)^2 + cv^2 sm2 + (ch hs)^2)

    Down the levels, with O = 0, o = (0, 0): P that something has run over an edge, and that times where it is, from m
      u = sqrt(vz^2 + 2 g pos(low - Z_l));  q = S((u - u0)/us);  a = F_l q + M_l (1 - q)
      L = vm (tc_l + kt)
      A_k = a box(x, a' + km, s) box(y, b' + km, s)                  at m + L - (X, Y);  a', b' half sizes
      i_k = visible box(x, a' + ko rho, s) box(y, b' + ko rho, s)    at m + o/(O + 1e-6) - (X, Y);  B_k = O i_k
      g = product over the level of 1 - i_k
      U_l = a + O (1 - g);  W_l = a L + O (1 - g) o/(O + 1e-6)
      j_k = box(x, a' - ke R, s) box(y, b' - ke R, s)                at m + W_l/(U_l + 1e-6) - (X, Y); 0 unless
                                                                     a' and b' exceed ke R
      h = product over the level of 1 - j_k;  O <- O g + U_l h;  o <- o g + W_l h

    What stands in the puddle
      U, W = sums of U_l, W_l over the levels that target k stands on or beside
      D_k = min(1, U) box(x, a' + kr rho, s) box(y, b' + kr rho, s)  at m + W/(U + 1e-6) - (X, Y)

    Together: P_k = 1 - (1 - A_k)(1 - B_k)(1 - D_k);  P(entity) = max over its targets, 0 if it has none

  Stopped: with constants of its own, but P(entity) is multiplied by out, and rho is another; kd, ka, tr, us, and the
  others as `places`: StopSettings
      T = max over the joints of |qd|/(kd greatest acceleration)     time that the robot needs to stop
      f = g e_z - ka vm/sqrt(T^2 + tr^2)                             what is felt in the container
      fill(c): as above, with c for z and without speed              c' = axis . f/sqrt(f . f + 1e-4);
                                                                     c = z g/sqrt(g^2 + 1e-4)
      e = 1 - S(ln fill(c)/us),  e' = 1 - S(ln fill(c')/us)          P that they stay, before and in the stop
      out = max(0, 1 - e'/e)
      lost = max(0, (1 + fill(c)^4)^(-1/4) - (1 + fill(c')^4)^(-1/4));  rho = R (lost + 0.01)^power

The volume that a tilted cylinder holds is a wedge; 1/(1 + x + x^2 + 1.7 x^3) is within 0.03 of it, in shares of what
it holds upright.

References:
    Depth of a puddle: capillary length and contact angle, de Gennes, Brochard-Wyart, Quéré, "Capillarity and Wetting
    Phenomena", 2004. The rest: own work, fitted to FailBench; see the heads of `spill.yaml` and `stop.yaml`.
"""
