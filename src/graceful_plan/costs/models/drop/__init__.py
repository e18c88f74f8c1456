r"""The drop model: entities that the carried object hits if the gripper lets go at this state.

A drop is computed in these steps with smooth formulas, so that the result has a gradient nearly everywhere:

0. *Blocking sides.* An object that flies against the side of something fixed, such as a wall or a rack, loses the
   velocity component into it, falls down in front of it, and has hit it. Only the side that stops it the most counts.
1. *First contact.* The object flies ballistically with the velocity of its centre of mass; each part has the velocity
   of the rotating tool at its position. A part hits a target if the two overlap in top view when it has fallen to the
   target's top. Shapes are octagons (a box in the target's axes and one rotated by 45 degrees) at uncertain positions.
2. *Support.* Whether the object stays where it lands depends on where the first contact supports it, below or beside
   its centre of mass, and on the width of the support relative to the height of that centre.
3. *Falls.* An object that does not stay moves away from its support and along its velocity. It falls if that takes it
   beyond the edges of what it landed on; on a wide table it only topples. Wide tops below its path catch it with some
   probability; otherwise it falls on.
4. *Side contacts.* On its way to rest it sweeps into targets beside its landing place.
5. *Own loss.* The object itself may be damaged where it lands first, and where a fall from there ends.
6. *Damage*, if wanted: whether a hit damages the entity, by the energy of the fall from the release to its top.

Specification
-------------
Everything is in double precision, z is up, g = 9.81. Tables: `DropTables`. Constants: `DropConstants`; those named
below carry the symbols given there; the tables of step 5 are `LossTables`, those of step 6 `damage_tables`. The native
kernel (native/impact/flight, drop.hpp, own_loss.hpp, entity_damage.hpp) follows this text operation by operation. So do
`sides.py` and `landing.py`, which cover the steps that moving entities need.

.. code-block:: text

    Functions
      S(u)       = 1/(1 + exp(-e(u/beta)))        beta = sqrt(3)/pi: logistic, standard deviation 1; e clamps to +-300
      box(x,A,s) : A <- max(A, 1e-4);  f = exp(e((x-A)/(s beta)));  h = exp(e(-(x+A)/(s beta)))
                   (1 - f h)/((1 + f)(1 + h))     = P(|x + noise| < A) for logistic noise of standard deviation s
      fall(h)    = (vz + sqrt(vz^2 + 2 g k))/g,   k = (h + sqrt(h^2 + 0.01^2))/2
      pos(x)     = (x + sqrt(x^2 + 0.01^2))/2
      c(x)       = t^2 (3 - 2 t),  t = 1/2 + x/2 held within 0 to 1

    Object (R, p: pose of the link; qd: joint velocities)
      c = R centre + p;  over the joints that move it: hinges w = sum qd_j z_j, v = sum qd_j (z_j x (c - p_j)),
      slides add qd_j z_j to v;  z_j, p_j: third axis and position of the joint's link
      part: o = R offset, axes Q = R rotation (columns); reach(u), u a unit vector:
        FLAT  sum_i |Q_i . u| h_i
        ROUND |Q_2 . u| h_2 + h_0 sqrt(max(1e-12, 1 - (Q_2 . u)^2))
        BALL  h_0
      bottom_p = c_z + o_z - reach(z);  low = min bottom_p;  high = max (c_z + o_z + reach(z));  hh = c_z - low
      m = squared z components of the main part's axes; FLAT (m0, m1, m2), ROUND (m0 + m1, m2), BALL (1)
      tilt = 1 - sum of the squares of these;  sp2 = vx^2 + vy^2;  sp = sqrt(sp2 + 1e-4)

    0. Blocking sides: for each fixed target the two axes; x is along the axis in question, y across, r as in step 1
      l, u = min and max over parts of ox - rx, ox + rx, likewise in y;  (x, y) = c - (X, Y), (vx, vy) in these axes
      gap = x + l - a if vx < 0, else -x - u - a;  t = max(gap, 0)/max(|vx|, 0.001);  w = max(t - delay, 0)
      y' = y + vy t + (ly + uy)/2;  s^2 = s0^2 + (sv t)^2;  h = low + vz w - g w^2/2
      E = c(gap/0.006 + 1) c((b + (uy - ly)/2 - |y'|)/(s sqrt5)) c((Z - h)/0.067) c((h + high - low - bottom)/0.067 - 1)
        times c(2 |vx|/0.1 - 1)
      the side with the greatest E |vx| max(T - t, 0) > 0 counts, with T = fall(low - lowest Z) + delay + 0.15:
        ts = t,  p = -E vx times the axis;  none: E = 0, p = 0
      push(T) = p max(T - ts, 0) is added below to every position at a time T after the release

    1. First contact: target k with centre (X, Y), axis (cos, sin), half sizes (a, b), diagonal d, top Z; x is along the
       axis, y to its left
      t = fall(bottom_p - Z);  s = sqrt(s0^2 + (sv t)^2)
      (x, y) = (c + o - (X, Y)) + (v + w x o)(t + delay) + push(t + delay), rotated into the target's axes
      D_p = box(x, a + rx, s) box(y, b + ry, s) box((x+y)/sqrt2, d + r1, s) box((y-x)/sqrt2, d + r2, s)
            S((bottom_p - Z)/0.008 + 1)         with the part's reaches rx, ry, r1, r2 in these four directions
      D = max over parts
      per level l (targets whose tops are within LEVEL of its highest), from the highest down:
        A_l = product of (1 - D) over all targets of higher levels;  U_l = 1 - product of (1 - D) over the level
      C_k = A_l D_k                                    share of the first contact; one object may touch several targets
      F_k = A_l U_l D_k/(sum of D over the level + 1e-6)      first impact, shared; sum over all targets <= 1
      tc_k = fall(low - Z) + delay
      total = sum F + 1e-6;  zs = sum F Z/total;  tl = sum F tc/total;  hs = sum F max(low - Z, 0)/total

    2. Support (a', b': half sizes of the supporting part of the top), per target and part, in its axes relative to c
      (X', Y') = (c - (X, Y)) + v tc_k + push(tc_k);  weight = exp(-((bottom_p - low)/0.012)^2)
      x from max(ox - rx, -a' - X') to min(ox + rx, a' - X'), y likewise; widths wx, wy >= 0; area = weight wx wy
      centre (mx, my) of that rectangle; second moments mx^2 + wx^2/12, my^2 + wy^2/12, mx my; all rotated into W
      per level: S0 = sum area + 1e-6;  E = sum area (centre)/S0;  V = sum area (second moments)/S0 - E E^T + 1e-5 I
      det = max(Vxx Vyy - Vxy^2, 1e-11);  d2 = (Vyy Ex^2 - 2 Vxy Ex Ey + Vxx Ey^2)/det;  off = d2/(3 + d2)
      narrow = det/(Vxx + Vyy)
      T_l = S(g0 + 2 gd (off - 1/2) + gt/2 ln((hh^2 + 1e-6)/(3 narrow)) + gv sp + 2 gti tilt)      P(it does not stay)
      n_l = -off E/sqrt(Ex^2 + Ey^2 + 1e-6)                                     direction in which it leaves
      M_k = F_k T_l

    3. Falls; L = c + v tl + push(tl) is the landing point
      ended = catch + (1 - catch) m^2/(m^2 + 0.1^2), m = min(a', b'): wide tops end nearly all falls
      sd = sqrt(s0^2 + (sv tl)^2 + (ch hs)^2 + cv^2 sp2 + (ct size)^2);  B = 0, N = (0, 0)
      levels from the highest down:
        (x, y) = c + v (tl + ks) + push(tl + ks) + drift size N/(B + 1e-6) - (X, Y), rotated into the target's axes
        G_k = B box(x, a + kb size, sd) box(y, b + kb size, sd)
        keep = product over the level of 1 - ended box(x, pos(a' + kc size), sd) box(y, pos(b' + kc size), sd)
        f_l = product over the level of 1 - ended box(..) box(..) as in keep, at L + v ks + push(..) + drift size n_l
        B <- B keep + f_l sum of M over the level;  N <- N keep + n_l f_l times that sum

    4. Side contacts
      Tm = sum M/total;  n = sum M n_l/total
      from x0 = (c - (X, Y)) + v tc_k + push(tc_k) to x1 = (c - (X, Y)) + v (tl + ksl) + push(tl + ksl) + drift size n,
        both rotated into the target's axes
      sl = sqrt(s0^2 + (sv tl)^2 + (ch hs)^2 + (cl size)^2 + (ct size Tm)^2);  r = (kl + tk Tm) size
      per axis: box((x0 + x1)/2, a + sqrt((x1 - x0)^2 + 1e-6)/2 + r, sl), y with b
      H_k = max(0, sum of F over this level and lower ones - C_k) S((zs + high - low - bottom_k)/sh) times these two
      for the target of the blocking side: H_k = max(H_k, E (1 - sum of F (1 - c((tl - ts)/0.067))))

    Together: P_k = 1 - (1 - C_k)(1 - G_k)(1 - H_k);  P(entity) = max over its targets of P_k, but at least the sum of
      their F_k, because first impacts exclude each other; 0 if it has none

    5. Own loss; ln e_k = strength, sd = spread of the tables, b = LANDING_LOSS; only the vertical speed does damage
      Q(z) = 1/(1 + exp(e(-z (1.5976 + 0.07056 z^2))))             the normal distribution function [1]
      damage(E, k) = sum over i of weight_i Q((ln(E/e_k) - b node_i)/sd)         E: energy per mass; two nodes: the
                                                  share of the energy that acts is e^-X, X exponential with mean b [2]
      w = g (tc_k - delay) - vz;  p_l = sum over the level of F_k damage(w^2/2, k)
      own = sum p_l;  A = 0, K = 0
      levels from the highest down, along with step 3:
        h = A/(B + 1e-6);  known = K/(B + 1e-6)
        c_k = ended box(..) box(..) as in keep; over the targets whose a' and b' exceed size, in order:
          own <- own + B c_k (product of 1 - c over the targets before it) max(0, damage(g pos(h - Z), k) - known)
        A <- A keep + Z' f_l sum of M over the level;  K <- K keep + f_l T_l p_l     Z': top of the level's first target

    6. Damage; ln e = strength, 1/sd = sharpness, b = CARRIED_LOSS, Z: the highest top of the entity
      a = max(ln(g pos(low - Z) + |v|^2/2 + 1e-9) - ln e, -6 sd)
      P(damage | hit) = max(0, Q(a/sd) - exp(-a/b + sd^2/(2 b^2)) Q(a/sd - sd/b))          see `costs.consequence`

References:
    Own work, fitted to rollouts in MuJoCo; see the head of `drop.yaml`.

    [1] S. R. Bowling, M. T. Khasawneh, S. Kaewkuekool, B. R. Cho, "A logistic approximation to the cumulative normal
    distribution", Journal of Industrial Engineering and Management 2 (2009).

    [2] Two-point Gauss-Laguerre rule for the closed form in `costs.consequence`; accurate to 0.03 if b = sd.
"""
