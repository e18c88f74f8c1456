// Algorithm 1 of the paper: entities below or beside the robot's boxes. In double precision, so that results equal a
// NumPy transcription.
#pragma once
#include "geometry/kinematics.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

constexpr double kLeastArea = 1e-12;  // least area of a body seen from above [m^2]; thinner bodies cannot be hit from
                                      // above

// Bounds of boxes over all lanes: the rectangle that contains them and their highest point. A few scalar comparisons
// with it rule out most targets.
struct Range {
  double least[2], most[2], highest;

  bool overlaps(const Target& t) const {
    return least[0] < t.upper[0] && most[0] > t.lower[0] && least[1] < t.upper[1] && most[1] > t.lower[1];
  }
  // A component above or beside an entity reaches higher than the entity's lowest point.
  bool may_hit(const Target& whole) const { return highest > whole.lower[2] && overlaps(whole); }
  void include(const Range& other) {
    for (int i = 0; i < 2; ++i) {
      least[i] = other.least[i] < least[i] ? other.least[i] : least[i];
      most[i] = other.most[i] > most[i] ? other.most[i] : most[i];
    }
    highest = other.highest > highest ? other.highest : highest;
  }
};

// The parts' boxes in W, seen from above, and the height range of each component.
struct PartBoxes {
  D lower[kMaxParts][2], upper[kMaxParts][2];
  D area[kMaxComponents], bottom[kMaxComponents], top[kMaxComponents];
  Range range[kMaxParts], all[kMaxComponents];
};

// The components that count: all, or those with a severity for some entity.
struct CountedComponents {
  const double* severity;  // null: compute all probabilities
  bool counts[kMaxComponents];
  int first_part[kMaxComponents + 1];  // parts are ordered by component

  CountedComponents(const Tables& tables, const double* S) : severity(S) {
    int k = 0;
    for (int r = 0; r < tables.n_component; ++r) {
      first_part[r] = k;
      while (k < tables.n_part && tables.part[k].component == r) ++k;
      first_part[r + 1] = k;
      counts[r] = !S;
      for (int e = 0; S && e < tables.n_entity; ++e) counts[r] |= S[r * tables.n_entity + e] != 0.0;
    }
  }
  double of(const Tables& tables, int r, int e) const { return severity[r * tables.n_entity + e]; }
};

static inline void place_parts(const Tables& tables, const Frame<D>* X_W, const CountedComponents& counted,
                               PartBoxes& boxes) {
  for (int r = 0; r < tables.n_component; ++r) {
    boxes.area[r] = D{}, boxes.bottom[r] = D{} + 1e9, boxes.top[r] = D{} - 1e9;
    boxes.all[r] = {{1e9, 1e9}, {-1e9, -1e9}, -1e9};
  }
  for (int k = 0; k < tables.n_part; ++k) {
    const Part& part = tables.part[k];
    if (!counted.counts[part.component]) continue;
    const Frame<D>& X = X_W[part.frame];
    const Vec<D> centre = transform(X, part.p);
    const D c[3] = {centre.x, centre.y, centre.z};
    D half[3];
    for (int i = 0; i < 3; ++i) {
      half[i] = D{};
      for (int j = 0; j < 3; ++j)
        half[i] += absolute(X.R[3 * i] * part.R[j] + X.R[3 * i + 1] * part.R[3 + j] + X.R[3 * i + 2] * part.R[6 + j]) *
                   part.half[j];
    }
    for (int i = 0; i < 2; ++i) {
      boxes.lower[k][i] = c[i] - half[i], boxes.upper[k][i] = c[i] + half[i];
      boxes.range[k].least[i] = least_lane(boxes.lower[k][i]),
      boxes.range[k].most[i] = greatest_lane(boxes.upper[k][i]);
    }
    const int r = part.component;
    boxes.bottom[r] = minimum(boxes.bottom[r], c[2] - half[2]), boxes.top[r] = maximum(boxes.top[r], c[2] + half[2]);
    boxes.range[k].highest = greatest_lane(c[2] + half[2]);
    boxes.all[r].include(boxes.range[k]);
    boxes.area[r] += 4.0 * half[0] * half[1];
  }
}

// P(entity, component) = min(1, max(sum I / sum A_entity, sum I / sum A_component)), with I the overlap of a pair of
// boxes in xy, A the area of a box in xy, and sums over all pairs or boxes. P is 0 unless the component as a whole is
// above the entity as a whole, or their heights overlap. Returns false, with P = 0, if no box comes near.
static inline bool interactions(const Tables& tables, const CountedComponents& counted, const PartBoxes& boxes,
                                int component, const Harmed& entity, D& P) {
  P = D{};
  const Target& whole = entity.bound;
  if (!boxes.all[component].may_hit(whole)) return false;
  const D bottom = boxes.bottom[component], top = boxes.top[component];
  const auto above = bottom > D{} + whole.upper[2];
  const auto beside = minimum(top, D{} + whole.upper[2]) - maximum(bottom, D{} + whole.lower[2]) > 0.0;
  if (!any(above | beside)) return false;
  D overlap = {};
  bool near = false;
  for (int k = counted.first_part[component]; k < counted.first_part[component + 1]; ++k) {
    for (int t = entity.first; t < entity.last; ++t) {
      const Target& target = tables.target[t];
      if (!boxes.range[k].overlaps(target)) continue;
      near = true;
      const D x =
          relu(minimum(boxes.upper[k][0], D{} + target.upper[0]) - maximum(boxes.lower[k][0], D{} + target.lower[0]));
      const D y =
          relu(minimum(boxes.upper[k][1], D{} + target.upper[1]) - maximum(boxes.lower[k][1], D{} + target.lower[1]));
      overlap += x * y;
    }
  }
  if (!near) return false;
  const D area = minimum(boxes.area[component], D{} + entity.area);
  P = ((above | beside) & (area > kLeastArea)) ? minimum(overlap / area, D{} + 1.0) : D{};
  return true;
}

template <class Visit>
static inline void for_each_interaction(const Tables& tables, const Frame<D>* X_W, const CountedComponents& counted,
                                        Visit visit) {
  PartBoxes boxes;
  place_parts(tables, X_W, counted, boxes);
  for (int entity = 0; entity < tables.n_entity; ++entity)
    for (int r = 0; r < tables.n_component; ++r) {
      if (!counted.counts[r] || (counted.severity && counted.of(tables, r, entity) == 0.0)) continue;
      D P;
      if (interactions(tables, counted, boxes, r, tables.harmed[entity], P) || !counted.severity) visit(r, entity, P);
    }
}

static inline D impact_of(const Tables& tables, const CountedComponents& counted, const D* q) {
  Frame<D> X_W[kMaxLinks];
  forward_kinematics(tables, q, X_W);
  D impact = {};
  for_each_interaction(tables, X_W, counted, [&](int r, int e, D P) { impact += P * counted.of(tables, r, e); });
  return impact;
}

}  // namespace gp::GP_ISA
