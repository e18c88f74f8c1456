r"""The spill model: entities that contents reach after a drop, after a spill from a held container, or after a stop.

Contents leave over the rim, land, spread to a puddle as deep as surface tension permits (dry contents to a heap), reach
things that stand in it, and run over the edges of their support to lower surfaces. The landing of the container in the
drop model serves for both `USES`: contents that leave a held container land on the same targets, at a less certain
place.

"dropped" is P(contents reach the entity | the gripper lets go); a soft landing spills nothing. "held" is P(contents
reach the entity | contents leave while the gripper holds). The probability of that condition hardly depends on the
state (fits to speed and tilt explain less than 1 % of the variance), so it is part of the fault prior.

"stopped" is P(contents reach the entity | protective stop of the robot). Spilling does depend on the state here: the
robot brakes, and contents move on. Speed, stopping time, fill level and tilt determine whether they go over the rim.
They leave with the velocity that the rim had. Accelerations before the stop, and surface waves beyond a constant
factor, are neglected.

Hot contents: severities already have columns for hot contents, so this model does not depend on temperature.

Specification
-------------
Symbols, functions and the drop model's results as in the docstring of `graceful_plan.costs.models.drop`; F_l, M_l: sums
over a level; tc_l: tc of its first target; Z_l: its top. Constants, for each use: `SpillConstants`. Tables:
`SpillTables`. The native kernel (native/impact/contents) follows this text.

.. code-block:: text

    Contents
      o = R mouth;  m = c + o;  vm = v + w x o;  sm2 = vmx^2 + vmy^2;  z = (R axis)_z;  p = (z + sqrt(z^2 + 0.01))/2
      lean = max(0, sqrt(1.0051 - p^2)/p - repose) + kv sqrt(sm2 + 1e-4);  x = r lean/H
      fill = (1 + x + x^2 + 1.7 x^3)/full        its capacity at this tilt is 1/fill of the initial contents
      rho = R (1 + fill^4)^(-power/4)            radius of a puddle of the remaining contents
      s = sqrt(s0^2 + (cr r)^2 + cv^2 sm2 + (ch hs)^2)

    Down the levels, with O = 0, o = (0, 0): P that contents have run over an edge, and P times their position, from m
      u = sqrt(vz^2 + 2 g pos(low - Z_l));  q = S((u - u0)/us);  a = F_l q + M_l (1 - q)
      L = vm (tc_l + kt)
      A_k = a box(x, a' + km, s) box(y, b' + km, s)                  at m + L - (X, Y);  a', b' half sizes
      i_k = visible box(x, a' + ko rho, s) box(y, b' + ko rho, s)    at m + o/(O + 1e-6) - (X, Y);  B_k = O i_k
      g = product over the level of 1 - i_k
      U_l = a + O (1 - g);  W_l = a L + O (1 - g) o/(O + 1e-6)
      j_k = box(x, a' - ke R, s) box(y, b' - ke R, s)                at m + W_l/(U_l + 1e-6) - (X, Y); 0 unless
                                                                     a' and b' exceed ke R
      h = product over the level of 1 - j_k;  O <- O g + U_l h;  o <- o g + W_l h

    Targets in the puddle
      U, W = sums of U_l, W_l over the levels that target k stands on or beside
      D_k = min(1, U) box(x, a' + kr rho, s) box(y, b' + kr rho, s)  at m + W/(U + 1e-6) - (X, Y)

    Together: P_k = 1 - (1 - A_k)(1 - B_k)(1 - D_k);  P(entity) = max over its targets, 0 if it has none

  Stopped: with its own constants, but P(entity) is multiplied by out, and rho differs; kd, ka, tr, us, and the
  others as `places`: StopSettings
      T = max over the joints of |qd|/(kd greatest acceleration)     stopping time of the robot
      f = g e_z - ka vm/sqrt(T^2 + tr^2)                             apparent gravity in the container
      fill(c): as above, with c for z and without speed              c' = axis . f/sqrt(f . f + 1e-4);
                                                                     c = z g/sqrt(g^2 + 1e-4)
      e = 1 - S(ln fill(c)/us),  e' = 1 - S(ln fill(c')/us)          P that they stay, before and in the stop
      out = max(0, 1 - e'/e)
      lost = max(0, (1 + fill(c)^4)^(-1/4) - (1 + fill(c')^4)^(-1/4));  rho = R (lost + 0.01)^power

The capacity of a tilted cylinder is a wedge; 1/(1 + x + x^2 + 1.7 x^3) is within 0.03 of it, relative to the upright
capacity.

References:
    Depth of a puddle: capillary length and contact angle, de Gennes, Brochard-Wyart, Quéré, "Capillarity and Wetting
    Phenomena", 2004. The rest: own work, fitted to FailBench; see the heads of `spill.yaml` and `stop.yaml`.
"""
