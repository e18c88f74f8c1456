// The body model: what the arm and what it holds hit if the drives fail here. The specification, with the letters used
// here, is in costs/models/body. W states side by side. What is left out to save time changes nothing.

constexpr double kFar = 8.0;  // U: scales beyond which nothing is hit
constexpr int kBins = 64;     // of lists of what is near, 2 cm each
constexpr double kBin = 0.02;
constexpr double kDetail = 0.3;  // from where a ball around an obstacle will do
constexpr double kSpare = 0.1;   // distances are kept as far as this above those that count

// --- dynamics -------------------------------------------------------------------------------------------------------

// Everything that hangs on a frame: mass, first moment and inertia about the origin of W.
struct Composite {
  D mass, h[3], J[6];  // J: xx yy zz xy xz yz

  void add(const Composite& other) {
    mass += other.mass;
    for (int i = 0; i < 3; ++i) h[i] += other.h[i];
    for (int i = 0; i < 6; ++i) J[i] += other.J[i];
  }
};

static inline Composite placed_inertia(const Inertia& rigid, const Frame<D>& X) {
  const Vec<D> c = transform(X, rigid.centre);
  const double* I = rigid.inertia;
  D A[9], R[6];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      A[3 * i + j] = X.R[3 * i] * I[j] + X.R[3 * i + 1] * I[3 + j] + X.R[3 * i + 2] * I[6 + j];
  constexpr int row[6] = {0, 1, 2, 0, 0, 1}, column[6] = {0, 1, 2, 1, 2, 2};
  for (int k = 0; k < 6; ++k) {
    const D *a = A + 3 * row[k], *b = X.R + 3 * column[k];
    R[k] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  }
  const double m = rigid.mass;
  return {D{} + m,
          {m * c.x, m * c.y, m * c.z},
          {R[0] + m * (c.y * c.y + c.z * c.z), R[1] + m * (c.x * c.x + c.z * c.z), R[2] + m * (c.x * c.x + c.y * c.y),
           R[3] - m * c.x * c.y, R[4] - m * c.x * c.z, R[5] - m * c.y * c.z}};
}

// How the origin of W would move if a joint did: angular and linear velocity.
struct Twist {
  Vec<D> w, v;
};

static inline Twist twist_of(const Link& link, const Frame<D>& X) {
  const Vec<D> z = {X.R[2], X.R[5], X.R[8]};
  if (link.slide) return {{D{}, D{}, D{}}, z};
  return {z, cross(X.p, z)};
}

static inline Twist momentum(const Composite& c, const Twist& t) {
  const Vec<D> h = {c.h[0], c.h[1], c.h[2]}, turn = cross(t.w, h), lever = cross(h, t.v);
  const D* J = c.J;
  return {{J[0] * t.w.x + J[3] * t.w.y + J[4] * t.w.z + lever.x, J[3] * t.w.x + J[1] * t.w.y + J[5] * t.w.z + lever.y,
           J[4] * t.w.x + J[5] * t.w.y + J[2] * t.w.z + lever.z},
          {c.mass * t.v.x + turn.x, c.mass * t.v.y + turn.y, c.mass * t.v.z + turn.z}};
}

static inline D power(const Twist& t, const Twist& momentum) {
  return t.w.x * momentum.w.x + t.w.y * momentum.w.y + t.w.z * momentum.w.z + t.v.x * momentum.v.x +
         t.v.y * momentum.v.y + t.v.z * momentum.v.z;
}

static inline D weight_torque(const Composite& c, const Twist& t) {
  return kGravity * (t.w.x * c.h[1] - t.w.y * c.h[0] + c.mass * t.v.z);
}

// Composites of all frames at least as far out as `first`.
static inline void gather(const Tables& tables, const BodyTables& body, const Frame<D>* X_W, int first,
                          Composite* all) {
  for (int l = first; l < body.n_frame; ++l) all[l] = placed_inertia(body.inertia[l], X_W[l]);
  for (int l = body.n_frame - 1; l > first; --l)
    if (tables.link[l].parent >= first) all[tables.link[l].parent].add(all[l]);
}

// M, lower half, and the torques that hold the arm.
static inline void mass_and_weight(const Tables& tables, const BodyTables& body, const Frame<D>* X_W, D M[][kMaxJoints],
                                   D* g) {
  Composite all[kMaxLinks];
  Twist twist[kMaxLinks];
  gather(tables, body, X_W, 0, all);
  for (int l = 0; l < body.n_frame; ++l)
    if (tables.link[l].joint >= 0) twist[l] = twist_of(tables.link[l], X_W[l]);
  for (int i = 0; i < tables.n_joint; ++i)
    for (int j = 0; j < tables.n_joint; ++j) M[i][j] = D{};
  for (int j = 0; j < tables.n_joint; ++j) {
    const int link = body.drive[j].link;
    const Twist moves = momentum(all[link], twist[link]);
    g[j] = weight_torque(all[link], twist[link]);
    for (int l = link; l >= 0; l = tables.link[l].parent) {
      const int i = tables.link[l].joint;
      if (i >= 0) M[i][j] = M[j][i] = power(twist[l], moves);
    }
    M[j][j] += body.drive[j].armature;
  }
}

// Solve A x = b by Cholesky's method; A is destroyed.
static inline void solve(D A[][kMaxJoints], D* b, int n) {
  for (int j = 0; j < n; ++j) {
    D d = A[j][j];
    for (int k = 0; k < j; ++k) d -= A[j][k] * A[j][k];
    const D inverse = inverse_root(d);
    A[j][j] = inverse;
    for (int i = j + 1; i < n; ++i) {
      D x = A[i][j];
      for (int k = 0; k < j; ++k) x -= A[i][k] * A[j][k];
      A[i][j] = x * inverse;
    }
  }
  for (int i = 0; i < n; ++i) {
    for (int k = 0; k < i; ++k) b[i] -= A[i][k] * b[k];
    b[i] *= A[i][i];
  }
  for (int i = n - 1; i >= 0; --i) {
    for (int k = i + 1; k < n; ++k) b[i] -= A[k][i] * b[k];
    b[i] *= A[i][i];
  }
}

static inline D towards_zero(D v, D by) { return v > 0 ? relu(v - by) : -relu(-v - by); }

// A joint that has moved by the mean of two velocities; a stop takes the velocity.
static inline void move_joint(const JointDrive& drive, D& x, D& v, D next, double h) {
  const D to = x + 0.5 * h * (v + next);
  v = (to < drive.lower) | (to > drive.upper) ? D{} : next;
  x = minimum(maximum(to, D{} + drive.lower), D{} + drive.upper);
}

static inline void fall_together(const Tables& tables, const BodyTables& body, const Frame<D>* X_W, double h, D* x,
                                 D* v) {
  const int n = tables.n_joint;
  D M[kMaxJoints][kMaxJoints], g[kMaxJoints], next[kMaxJoints], slip[kMaxJoints];
  mass_and_weight(tables, body, X_W, M, g);
  for (int i = 0; i < n; ++i) {
    next[i] = -h * g[i];
    for (int j = 0; j < n; ++j) next[i] += M[i][j] * v[j];
  }
  for (int i = 0; i < n; ++i) {
    M[i][i] += h * body.drive[i].damping;
    slip[i] = h * body.drive[i].friction * reciprocal(M[i][i]);
  }
  solve(M, next, n);
  for (int i = 0; i < n; ++i) move_joint(body.drive[i], x[i], v[i], towards_zero(next[i], slip[i]), h);
}

// What a joint without power moves by: inertia at the state itself, torque of the weight where it is by now.
static inline D weight_on(const Tables& tables, const BodyTables& body, const Frame<D>* X_W, int first) {
  D mass[kMaxLinks];
  Vec<D> h[kMaxLinks];
  for (int l = first; l < body.n_frame; ++l) {
    const Vec<D> c = transform(X_W[l], body.inertia[l].centre);
    mass[l] = D{} + body.inertia[l].mass;
    h[l] = {mass[l] * c.x, mass[l] * c.y, mass[l] * c.z};
  }
  for (int l = body.n_frame - 1; l > first; --l) {
    const int to = tables.link[l].parent;
    if (to >= first) mass[to] += mass[l], h[to] = {h[to].x + h[l].x, h[to].y + h[l].y, h[to].z + h[l].z};
  }
  const Twist t = twist_of(tables.link[first], X_W[first]);
  return kGravity * (t.w.x * h[first].y - t.w.y * h[first].x + mass[first] * t.v.z);
}

struct JointMotion {
  D x, v;
};

static inline void fall_alone(const Tables& tables, const BodyTables& body, const Frame<D>* X_W, int joint, D inertia,
                              JointMotion& motion) {
  const JointDrive& drive = body.drive[joint];
  const double h = body.constants.step;
  const D share = reciprocal(inertia + h * (drive.damping + drive.resistance));
  const D next = (inertia * motion.v - h * weight_on(tables, body, X_W, drive.link)) * share;
  move_joint(drive, motion.x, motion.v, towards_zero(next, h * drive.friction * share), h);
}

// M_jj of all joints.
static inline void own_inertias(const Tables& tables, const BodyTables& body, const Frame<D>* X_W, D* inertia) {
  Composite all[kMaxLinks];
  gather(tables, body, X_W, 0, all);
  for (int j = 0; j < tables.n_joint; ++j) {
    const int link = body.drive[j].link;
    const Twist t = twist_of(tables.link[link], X_W[link]);
    inertia[j] = power(t, momentum(all[link], t)) + body.drive[j].armature;
  }
}

// --- distances ------------------------------------------------------------------------------------------------------

struct Near {
  float gap;  // no more than between the bounding sphere of a group and an obstacle, at the state itself
  int32_t obstacle;
};

// Obstacles around each group, nearest first: what is in reach of a failed configuration is at the head.
struct Surroundings {
  Vec<D> centre[kMaxLinks];
  size_t count[kMaxLinks];
  Near *near, *scratch;  // [group, obstacle], [obstacle]
  // Distances of pairs as the arm is expected to be, as far as they are below `far` and somebody asked: [step, group,
  // obstacle].
  D* distance;
  uint8_t* known;
  double far;

  // Of one step and group: where the rows of both tables begin.
  static size_t row(const Tables& tables, int step, int g) {
    return (size_t(step) * size_t(tables.n_group) + size_t(g)) * size_t(tables.n_obstacle);
  }
  void look(const Tables& tables, const BodyTables& body, const Frame<D>* X_W) {
    for (int g = 0; g < tables.n_group; ++g) {
      if (body.row[g] < 0) continue;
      size_t in_bin[kBins + 1] = {}, n = 0;
      const Group& group = tables.group[g];
      centre[g] = transform(X_W[group.frame], group.bound);
      for (int j = 0; j < tables.n_obstacle; ++j) {
        const Obstacle& o = tables.obstacle[j];
        if (o.ignores >> group.link & 1) continue;
        const float gap = least_gap(tables, o, centre[g]) - group.bound[3] - 1e-6f;
        scratch[n++] = {gap, j};
        ++in_bin[bin(gap) + 1];
      }
      for (int b = 0; b < kBins; ++b) in_bin[b + 1] += in_bin[b];
      for (size_t k = 0; k < n; ++k) of(tables, g)[in_bin[bin(scratch[k].gap)]++] = scratch[k];
      count[g] = n;
    }
  }
  Near* of(const Tables& tables, int g) const { return near + size_t(g) * size_t(tables.n_obstacle); }
  // What any that follows is at least away.
  static double edge(double gap) { return gap < kBin * kBins ? gap - kBin : kBin * (kBins - 1); }

 private:
  static int bin(float gap) {
    const int b = int(gap * float(1.0 / kBin));
    return b < 0 ? 0 : b >= kBins ? kBins - 1 : b;
  }
  // Of a point to an obstacle; where that is far, to a ball around it.
  static float least_gap(const Tables& tables, const Obstacle& o, const Vec<D>& point) {
    if (o.bound[3] >= 0.f) {
      const Vec<D> middle = {D{} + o.bound[0], D{} + o.bound[1], D{} + o.bound[2]};
      const double away = __builtin_sqrt(least_lane(squared_distance(point, middle))) - o.bound[3];
      if (away > kDetail) return float(away) - 1e-6f;
    }
    return float(least_lane(signed_distance(tables, o, point)));
  }
};

// The least distance of one way to fail, for each row and entity, and how deep the arm is in what stops it.
struct Way {
  D best[2][kMaxEntities], blocked;
  double gain = 0.0, tolerance = 0.0, cut[2], worst[2][kMaxEntities];  // worst: of the lanes of best

  // From nothing, or from what is met before anything moves.
  void begin(const BodyTables& body, int generator, const Way* home) {
    const BodyConstants& k = body.constants;
    gain = k.stop_gain[generator], tolerance = k.stop_tolerance[generator];
    for (int r = 0; r < body.n_row; ++r) {
      cut[r] = home ? 0.0 : 1e-9;
      for (int g = 0; g < kGenerators; ++g) {
        const double far = k.offset[g][r] + kFar * k.spread[g][r];
        if (home ? g == generator : far > cut[r]) cut[r] = far;
      }
      for (int e = 0; e < body.n_entity; ++e) {
        best[r][e] = home ? minimum(D{} + cut[r], home->best[r][e]) : D{} + cut[r];
        worst[r][e] = home && home->worst[r][e] < cut[r] ? home->worst[r][e] : cut[r];
      }
    }
    blocked = home ? home->blocked : D{};
  }
};

// Distance of a group to an obstacle as far as it is below `need`.
static inline D group_distance(const Tables& tables, const Obstacle& o, const Group& group, const Frame<D>& X, D need) {
  D least = need;
  for (int c = group.first_cluster; c < group.first_cluster + group.n_cluster; ++c) {
    const Cluster& cluster = tables.cluster[c];
    if (group.n_cluster > 1 &&
        !any(signed_distance(tables, o, transform(X, cluster.bound)) - cluster.bound[3] < least + 1e-6))
      continue;
    for (int k = cluster.first; k < cluster.first + cluster.count; ++k)
      least =
          minimum(least, signed_distance(tables, o, transform(X, tables.sphere + 4 * k)) - tables.sphere[4 * k + 3]);
  }
  return least;
}

// How far any point of a group is at most from where it is expected.
static inline D displacement(const Group& group, const Frame<D>& X, const Frame<D>& expected) {
  D turned = {};
  for (int k = 0; k < 9; ++k) turned += (X.R[k] - expected.R[k]) * (X.R[k] - expected.R[k]);
  const D moved = squared_distance(transform(X, group.bound), transform(expected, group.bound));
  return root(moved) + double(group.bound[3]) * root(0.5 * turned) + 1e-9;
}

// Distance of a group to an obstacle where it is expected to be, as far as it is below `far`.
static inline D expected_distance(const Tables& tables, const Surroundings& around, int step, int g, int j,
                                  const Frame<D>& expected) {
  const size_t at = Surroundings::row(tables, step, g) + size_t(j);
  if (!around.known[at]) {
    const Group& group = tables.group[g];
    const Obstacle& o = tables.obstacle[j];
    const Vec<D> centre = transform(expected, group.bound);
    const D far = D{} + around.far;
    const bool near = any(near_bound(o, centre, far + (double(group.bound[3]) + 1e-6))) &&
                      any(signed_distance(tables, o, centre) - group.bound[3] < far + 1e-6);
    around.distance[at] = near ? group_distance(tables, o, group, expected, far) : far;
    around.known[at] = 1;
  }
  return around.distance[at];
}

// --- ways to fail ---------------------------------------------------------------------------------------------------

struct Arm {
  const Tables& tables;
  const BodyTables& body;
  const double* severity;  // null: everything counts
  Surroundings around;
  D reference[kMaxSteps + 1][kMaxJoints];
  Frame<D> expected[kMaxSteps + 1][kMaxLinks], X_W[kMaxLinks];  // expected: X_W of reference
  Way way, home;                                                // home: where the arm is
  D inertia[kMaxJoints];                                        // M_jj there
  int reference_steps, known_ahead, inertia_known;

  // One failed configuration: as expected at a step of the motion to come, but for frames from `first` on.
  void meet(const Frame<D>* poses, int step, int first, Way& met) const {
    const D penalty = met.gain * relu(met.blocked - met.tolerance);
    D depth = met.blocked;
    for (int g = 0; g < tables.n_group; ++g) {
      const int r = body.row[g];
      if (r < 0) continue;
      const Group& group = tables.group[g];
      const Vec<D> centre = transform(poses[group.frame], group.bound);
      const double moved = __builtin_sqrt(greatest_lane(squared_distance(centre, around.centre[g]))) + 1e-9;
      const double cut = (met.cut[r] > 0.0 ? met.cut[r] : 0.0) + moved;
      const bool as_expected = group.frame < first;
      const D off = as_expected ? D{} : displacement(group, poses[group.frame], expected[step][group.frame]);
      const bool close = as_expected || greatest_lane(off) < kSpare;  // else what is expected says little
      const Near* near = around.of(tables, g);
      for (size_t i = 0; i < around.count[g]; ++i) {
        const double gap = double(near[i].gap);
        if (Surroundings::edge(gap) > cut) break;
        const int j = near[i].obstacle, e = body.entity[j];
        const bool counts = e >= 0 && (!severity || severity[r * body.n_entity + e] != 0.0);
        const double least = gap - moved;
        if (!(counts && least < met.worst[r][e]) && !(least < 0.0)) continue;
        const Obstacle& o = tables.obstacle[j];
        const D need = maximum(counts ? met.best[r][e] - penalty : D{} - 1e9, -depth);
        if (!any(near_bound(o, centre, relu(need + (double(group.bound[3]) + 1e-6))))) continue;
        D d = {};
        if (close) {
          d = expected_distance(tables, around, step, g, j, expected[step][group.frame]);
          if (!any(d - off < need)) continue;
        }
        if (!as_expected) {
          if (!any(signed_distance(tables, o, centre) - group.bound[3] < need + 1e-6)) continue;
          d = group_distance(tables, o, group, poses[group.frame], need);
        }
        depth = maximum(depth, -d);
        if (!counts) continue;
        met.best[r][e] = minimum(met.best[r][e], d + penalty);
        met.worst[r][e] = greatest_lane(met.best[r][e]);
      }
    }
    met.blocked = depth;
  }
  void meet_at(const Frame<D>* poses, int s, int first) { meet(poses, s, first, way); }
  // As expected but for one joint.
  void place(int s, int joint, D at) {
    D x[kMaxJoints];
    const int link = body.drive[joint].link;
    for (int j = 0; j < tables.n_joint; ++j) x[j] = j == joint ? at : reference[s][j];
    for (int l = 0; l < link; ++l) X_W[l] = expected[s][l];
    forward_kinematics(tables, x, X_W, link);
  }

  // Where the arm would be, as far as is known.
  void begin(const D* q, const D* qd, const double* ahead, size_t first, size_t n) {
    const int nq = tables.n_joint;
    reference_steps = ahead ? body.n_reference : body.n_step;
    known_ahead = ahead != nullptr;
    for (int j = 0; j < nq; ++j) reference[0][j] = q[j];
    for (int s = 1; s <= reference_steps; ++s) {
      const double T = body.constants.carry_on, t = s * body.constants.step;
      const double share = T > 0 ? T * (1.0 - scalar_exponential(-t / T)) : 0.0;
      for (int j = 0; j < nq; ++j)
        if (!ahead)
          reference[s][j] =
              minimum(maximum(q[j] + share * qd[j], D{} + body.drive[j].lower), D{} + body.drive[j].upper);
      for (int i = 0; ahead && i < kLanes<double>; ++i) {
        const size_t state = first + size_t(i) < n ? first + size_t(i) : n - 1;
        for (int j = 0; j < nq; ++j)
          reference[s][j][i] = ahead[(state * size_t(reference_steps) + size_t(s - 1)) * size_t(nq) + size_t(j)];
      }
    }
    for (int s = 0; s <= reference_steps; ++s) forward_kinematics(tables, reference[s], expected[s]);
    inertia_known = false;
    around.look(tables, body, expected[0]);
    home.begin(body, kStray, nullptr);
    around.far = (body.n_row > 1 && home.cut[1] > home.cut[0] ? home.cut[1] : home.cut[0]) + kSpare;
    std::fill_n(around.known, Surroundings::row(tables, reference_steps + 1, 0), uint8_t(0));
    meet(expected[0], 0, kMaxLinks, home);
  }

  void collapse(const D* qd) {
    constexpr int steps = 5;
    D x[kMaxJoints], v[kMaxJoints];
    for (int j = 0; j < tables.n_joint; ++j) x[j] = reference[0][j], v[j] = qd[j];
    way.begin(body, kCollapse, &home);
    for (int s = 0; s < steps; ++s) {
      fall_together(tables, body, s ? X_W : expected[0], body.constants.brake_time / steps, x, v);
      forward_kinematics(tables, x, X_W);
      meet_at(X_W, 0, 0);
    }
    for (int j = 0; j < tables.n_joint; ++j)
      x[j] = minimum(maximum(x[j] + body.constants.brake_stop * v[j], D{} + body.drive[j].lower),
                     D{} + body.drive[j].upper);
    forward_kinematics(tables, x, X_W);
    meet_at(X_W, 0, 0);
  }
  void loose(int joint, const D* qd) {
    if (!inertia_known) own_inertias(tables, body, expected[0], inertia);
    inertia_known = true;
    JointMotion motion{reference[0][joint], qd[joint]};
    way.begin(body, kJoint, &home);
    for (int s = 1; s <= reference_steps; ++s) {
      const D was = motion.x, before = way.blocked;
      fall_alone(tables, body, s > 1 ? X_W : expected[0], joint, inertia[joint], motion);
      place(s, joint, motion.x);
      meet_at(X_W, s, body.drive[joint].link);
      const auto rests = way.blocked > before + way.tolerance;
      motion = {rests ? was : motion.x, rests ? D{} : motion.v};
      way.blocked = rests ? before : way.blocked;
    }
  }
  void stuck(int joint) {
    way.begin(body, kStuck, &home);
    for (int s = known_ahead ? 1 : reference_steps; s <= reference_steps && s; ++s) {
      place(s, joint, reference[0][joint]);
      meet_at(X_W, s, body.drive[joint].link);
    }
  }
  void stray() {
    way.begin(body, kStray, &home);
    for (int s = known_ahead ? 1 : reference_steps; s <= reference_steps && s; ++s) meet_at(expected[s], s, kMaxLinks);
  }

  D probability(int generator, int row, int entity) const {
    const BodyConstants& k = body.constants;
    const double least = 1.0 / (1.0 + scalar_exponential(kFar));
    const D P =
        reciprocal(1.0 + odds((way.best[row][entity] - k.offset[generator][row]) * (1.0 / k.spread[generator][row])));
    return relu(P - least) * (1.0 / (1.0 - least));
  }

  // Every way to fail that has a weight: collapse, each joint loose, each joint stuck, stray.
  template <class Visit> void fail(const D* qd, const double* weight, Visit visit) {
    const int n = tables.n_joint;
    for (int mode = 0; mode < 2 * n + 2; ++mode) {
      if (weight && !counts(weight + mode * body.n_row)) continue;
      const int generator = mode == 0 ? kCollapse : mode <= n ? kJoint : mode <= 2 * n ? kStuck : kStray;
      if (generator == kCollapse) collapse(qd);
      if (generator == kJoint) loose(mode - 1, qd);
      if (generator == kStuck) stuck(mode - 1 - n);
      if (generator == kStray) stray();
      visit(mode, generator);
    }
  }

 private:
  bool counts(const double* weight) const {
    return std::any_of(weight, weight + body.n_row, [](double w) { return w != 0.0; });
  }
  static double scalar_exponential(double x) { return exponential(D{} + x)[0]; }
};

static inline D body_impact_of(Arm& arm, const double* weight, const D* q, const D* qd) {
  D impact = {};
  arm.begin(q, qd, nullptr, 0, 1);
  arm.fail(qd, weight, [&](int mode, int generator) {
    for (int r = 0; r < arm.body.n_row; ++r)
      for (int e = 0; e < arm.body.n_entity; ++e) {
        const double S = weight[mode * arm.body.n_row + r] * arm.severity[r * arm.body.n_entity + e];
        if (S != 0.0 && any(arm.way.best[r][e] < arm.way.cut[r])) impact += S * arm.probability(generator, r, e);
      }
  });
  return impact;
}
