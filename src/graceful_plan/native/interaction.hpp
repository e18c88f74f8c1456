// Algorithm 1 of the paper: what lies below the robot's boxes, in double so that it equals a NumPy transcription.

using D = Lanes<double>;

struct PartBoxes {
  D lower[kMaxParts][2], upper[kMaxParts][2], bottom[kMaxParts];
  D area[kMaxComponents];
};

static inline void place_parts(const Tables& tables, const Frame<D>* X_W, PartBoxes& boxes) {
  for (int r = 0; r < tables.n_component; ++r) boxes.area[r] = D{};
  for (int k = 0; k < tables.n_part; ++k) {
    const Part& part = tables.part[k];
    const Frame<D>& X = X_W[part.frame];
    const Vec<D> centre = transform(X, part.p);
    const D c[3] = {centre.x, centre.y, centre.z};
    D half[3];
    for (int i = 0; i < 3; ++i) {
      half[i] = D{};
      for (int j = 0; j < 3; ++j)
        half[i] += absolute(X.R[3 * i] * part.R[j] + X.R[3 * i + 1] * part.R[3 + j] + X.R[3 * i + 2] * part.R[6 + j]) * part.half[j];
    }
    for (int i = 0; i < 2; ++i) boxes.lower[k][i] = c[i] - half[i], boxes.upper[k][i] = c[i] + half[i];
    boxes.bottom[k] = c[2] - half[2];
    boxes.area[part.component] += 4.0 * half[0] * half[1];
  }
}

// P(entity, component) = max(sum I / sum A_entity, sum I / sum A_component), I the overlap in xy of a pair of boxes of
// which the component's is entirely above; sums over all pairs, respectively all boxes; at most 1.
static inline void interactions(const Tables& tables, const PartBoxes& boxes, int component, int first_target, int last_target, D& P) {
  D overlap = {};
  for (int k = 0; k < tables.n_part; ++k) {
    if (tables.part[k].component != component) continue;
    for (int t = first_target; t < last_target; ++t) {
      const Target& target = tables.target[t];
      D x = relu(minimum(boxes.upper[k][0], D{} + target.upper[0]) - maximum(boxes.lower[k][0], D{} + target.lower[0]));
      D y = relu(minimum(boxes.upper[k][1], D{} + target.upper[1]) - maximum(boxes.lower[k][1], D{} + target.lower[1]));
      overlap += boxes.bottom[k] > target.upper[2] ? x * y : D{};
    }
  }
  const D area = minimum(boxes.area[component], D{} + tables.target_area[tables.target[first_target].entity]);
  P = minimum(overlap / area, D{} + 1.0);
}

template <class Visit> static inline void for_each_interaction(const Tables& tables, const Frame<D>* X_W, const double* severity, Visit visit) {
  PartBoxes boxes;
  place_parts(tables, X_W, boxes);
  for (int t = 0, end = 0; t < tables.n_target; t = end) {
    const int entity = tables.target[t].entity;
    while (end < tables.n_target && tables.target[end].entity == entity) ++end;
    for (int r = 0; r < tables.n_component; ++r) {
      if (severity && severity[r * tables.n_entity + entity] == 0.0) continue;
      D P;
      interactions(tables, boxes, r, t, end, P);
      visit(r, entity, P);
    }
  }
}

static inline D impact_of(const Tables& tables, const double* severity, const D* q) {
  Frame<D> X_W[kMaxLinks];
  forward_kinematics<double>(tables, q, X_W);
  D impact = {};
  for_each_interaction(tables, X_W, severity, [&](int r, int e, D P) { impact += P * severity[r * tables.n_entity + e]; });
  return impact;
}
