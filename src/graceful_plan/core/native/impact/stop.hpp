// The inertial spill: what leaves a container when the robot stops by itself. The specification, with the letters used
// here, is in costs/models/spill.

// What a container keeps whose axis has this cosine with the upward direction of what is felt in it.
struct Leaning {
  D root, up, slope, x, fill, fourth, kept;

  Leaning(const SpillTables& spill, D cosine) {
    root = square_root(cosine * cosine + 0.01), up = 0.5 * (cosine + root);
    slope = square_root(1.0051 - up * up) * reciprocal(up);
    x = relu(slope - spill.repose) * (spill.rim / spill.depth);
    fill = (1.0 + x * (1.0 + x * (1.0 + 1.7 * x))) * (1.0 / spill.full);
    fourth = 1.0 + fill * fill * fill * fill;
    kept = exponential(-0.25 * logarithm(fourth));
  }
};

// e: P that all contents stay, but for what nobody notices.
struct Staying {
  D exponent, value;

  Staying(const StopTables& stop, const Leaning& leaning)
      : exponent(logarithm(leaning.fill) * (1.0 / (kBeta * stop.spread))), value(reciprocal(1.0 + odds(exponent))) {}
};

// T: how long the robot needs to stop.
static inline D stopping_time(const Tables& tables, const StopTables& stop, const D* qd) {
  D longest = {};
  for (int j = 0; j < tables.n_joint; ++j) longest = maximum(longest, absolute(qd[j]) * stop.slowness[j]);
  return longest;
}

constexpr double kLeastFelt = 1e-4;  // squared [m^2/s^4]

struct Stop {
  D time, rate;  // a = rate vm
  Vec<D> felt;
  D inverse, cosine;  // of |felt|; of the axis
  Leaning before, braked;
  Staying stayed, stays;
  D chance, lost, rho;

  Stop(const SpillTables& spill, const StopTables& stop, const Mouth& mouth, D seconds)
      : time(seconds),
        rate(stop.amplification * inverse_root(time * time + stop.response * stop.response)),
        felt{-rate * mouth.vx, -rate * mouth.vy, kGravity - rate * mouth.vz},
        inverse(inverse_root(felt.x * felt.x + felt.y * felt.y + felt.z * felt.z + kLeastFelt)),
        cosine((mouth.axis.x * felt.x + mouth.axis.y * felt.y + mouth.axis.z * felt.z) * inverse),
        before(spill, mouth.axis.z * kGravity * still()),
        braked(spill, cosine),
        stayed(stop, before),
        stays(stop, braked) {
    chance = relu(1.0 - stays.value * reciprocal(stayed.value));
    lost = relu(before.kept - braked.kept);
    rho = spill.radius * exponential(spill.power * logarithm(lost + kLeastLost));
  }
  // What `inverse` is at rest: exactly then a stop changes nothing.
  static D still() { return inverse_root(D{} + (kGravity * kGravity + kLeastFelt)); }
};
