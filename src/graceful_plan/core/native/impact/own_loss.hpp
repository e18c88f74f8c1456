// Step 5 of the drop model: own loss, the damage to the carried object itself.

// P that the object is damaged on a surface, from the log of its vertical energy per mass, and the derivative.
struct Damage {
  D value, slope;

  [[gnu::always_inline]] Damage(const LossTables& loss, const Surface& s, D log_energy) {
    const D z = (log_energy - s.strength) * loss.sharpness, a = z - loss.shift[0], b = z - loss.shift[1];
    const D a2 = a * a, b2 = b * b;
    // The normal distribution function of a and b, by Bowling et al. 2009: [1] of the specification.
    const D over_a = odds(-a * (1.5976 + 0.07056 * a2)), over_b = odds(-b * (1.5976 + 0.07056 * b2));
    const D both = reciprocal((1.0 + over_a) * (1.0 + over_b));
    const D below_a = (1.0 + over_b) * both, below_b = (1.0 + over_a) * both;
    value = loss.weight[0] * below_a + loss.weight[1] * below_b;
    slope = (loss.weight[0] * below_a * (1.0 - below_a) * (1.5976 + 0.21168 * a2) +
             loss.weight[1] * below_b * (1.0 - below_b) * (1.5976 + 0.21168 * b2)) *
            loss.sharpness;
  }
};

// Vertical speed at the first contact with a surface.
static inline D arrival_speed(const DropTables& drop, const Flight& flight, D time) {
  return kGravity * (time - drop.constants.delay) - flight.v.z;
}
static inline D log_arrival(D speed) { return logarithm(maximum(0.5 * speed * speed, D{} + 1e-9)); }

// P that the first contact with a level damages the object.
static inline D first_damage(const DropTables& drop, const Flight& flight, const Landing& landing, int level) {
  D sum = {}, log_energy = {};
  if (!any(landing.first[level] > kRare)) return sum;
  double top = __builtin_inf();
  for (int k = drop.level_start[level]; k < drop.level_start[level + 1]; ++k) {
    const Surface& s = drop.surface[k];
    const D lands = landing.share[level] * landing.overlap[k];
    if (!any(lands > kRare)) continue;
    if (s.top != top) log_energy = log_arrival(arrival_speed(drop, flight, landing.time[k]));
    top = s.top;
    sum += lands * Damage(drop.loss, s, log_energy).value;
  }
  return sum;
}

// Own loss along a Tumble: after falling off, the object is damaged where it is stopped, unless the first contact did
// so.
struct OwnLoss {
  D probability = {};
  D lift = {}, borne = {};      // A, K in the specification of step 5
  D share = {}, height, known;  // on the present level: 1/(B + 1e-6), h, damage already done by the first contact
  D log_energy;
  double top;

  void enter(const Tumble& tumble) {
    share = reciprocal(tumble.mass + kLeastMass);
    height = lift * share, known = borne * share, top = __builtin_inf();
  }
  // Damage if the object is stopped by a surface.
  Damage fall(const DropTables& drop, const Surface& s) {
    if (s.top != top) {
      const D h = height - s.top;
      log_energy = logarithm(maximum((0.5 * kGravity) * (h + square_root(h * h + 1e-4)), D{} + 1e-9));
    }
    top = s.top;
    return Damage(drop.loss, s, log_energy);
  }
  void end(const DropTables& drop, const Surface& s, const Tumble& tumble) {
    if (!s.holds) return;
    const D ends = tumble.mass * tumble.caught;
    if (any(ends > kRare)) probability += ends * relu(fall(drop, s).value - known);
  }
  // Call it after the last surface of a level and before tumble.leave(); `damaged`: first_damage() of the level.
  void leave(const DropTables& drop, const Landing& landing, int level, const Tumble& tumble, D damaged) {
    probability += damaged;
    lift = lift * tumble.keep + landing.leaving[level] * drop.surface[drop.level_start[level]].top;
    borne = borne * tumble.keep + landing.leaves[level] * damaged;
  }
};
