// The kernels of one instruction set. This file is compiled once per set, see target.hpp.
#include "blocks.hpp"
#include "cutoffs.hpp"
#include "geometry/bounds.hpp"
#include "geometry/clearance.hpp"
#include "geometry/gradient.hpp"
#include "geometry/kinematics.hpp"
#include "geometry/nearest.hpp"
#include "geometry/reach.hpp"
#include "impact/body.hpp"
#include "impact/body_gradient.hpp"
#include "impact/impact_of_drop.hpp"
#include "impact/interaction.hpp"
#include "impact/moving/hit.hpp"
#include "impact/moving/hit_gradient.hpp"
#include "impact/moving/near.hpp"
#include "tables.hpp"

namespace gp {
namespace GP_ISA {

static void link_poses(const Tables& tables, const States& states, double* X_WL) {
  for_each_block<D>(tables, states, [&](size_t first, int count, const Frame<D>* X_W) {
    for (int i = 0; i < count; ++i)
      for (int l = 0; l < tables.n_link; ++l) {
        const Frame<D>& X = X_W[tables.link[l].frame];
        double* out = X_WL + ((first + size_t(i)) * size_t(tables.n_link) + size_t(l)) * 16;
        const double p[3] = {X.p.x[i], X.p.y[i], X.p.z[i]};
        for (int r = 0; r < 3; ++r) {
          for (int c = 0; c < 3; ++c) out[4 * r + c] = X.R[3 * r + c][i];
          out[4 * r + 3] = p[r];
        }
        out[12] = out[13] = out[14] = 0.0;
        out[15] = 1.0;
      }
  });
}

// Comparisons with NaN are false, so collision checks would report "free".
static inline bool is_number(const double* q, size_t n) {
  double sum = 0;
  for (size_t j = 0; j < n; ++j) sum += q[j] * 0;
  return sum == 0;
}

static void free_states(const Tables& tables, const States& states, double margin, uint8_t* free) {
  const size_t nq = size_t(tables.n_joint);
  for_each_block<F>(tables, states, [&](size_t first, int count, const Frame<F>* X_W) {
    const MaskF hit = breaks(tables, X_W, float(margin)) | collides<false>(tables, X_W, float(margin));
    for (size_t i = 0; i < size_t(count); ++i)
      free[first + i] = !hit[int(i)] && is_number(states.q + (first + i) * nq, nq);
  });
}

constexpr double kMostPieces = 1e8;  // largest number of pieces of an edge; edges with NaN fail the comparison, too

// Each block samples the whole edge, shifted against the others, so that a colliding edge is detected in the first
// blocks.
static bool edge_is_free(const Tables& tables, const double* q0, const double* q1, double step, float margin) {
  constexpr int W = kLanes<float>;
  F qs[kMaxJoints], lane;
  Frame<F> X_W[kMaxLinks];
  for (int i = 0; i < W; ++i) lane[i] = float(i);
  const double pieces = distance(tables, q0, q1) / step;
  if (!(pieces <= kMostPieces)) return false;
  const int n_block = int((pieces + 1.0) / W) + 1;
  const float spacing = 1.f / float(W * n_block - 1);
  for (int b = 0; b < n_block; ++b) {
    interpolate<float>(tables, q0, q1, (lane * float(n_block) + float(b)) * spacing, qs);
    forward_kinematics(tables, qs, X_W);
    if (any(breaks(tables, X_W, margin)) || any(collides<true>(tables, X_W, margin))) return false;
  }
  return true;
}

static void free_edges(const Tables& tables, const Edges& edges, double margin, uint8_t* free) {
  const size_t nq = size_t(tables.n_joint);
  for (size_t k = 0; k < edges.n; ++k)
    free[k] = edge_is_free(tables, edges.q0 + k * nq, edges.q1 + k * nq, edges.step, float(margin));
}

// Gradients for states whose nearest pairs are known. They are in double precision: single is too coarse between near
// spheres.
static void clearance_gradients(const Tables& tables, const Nearest& pair, const States& states, double* gradient) {
  for_each_block<D>(tables, states, [&](size_t first, int count, const Frame<D>* X_W) {
    for (size_t k = first; k < first + size_t(count); ++k) {
      double* out = gradient + k * size_t(tables.n_joint);
      clearance_gradient({tables, X_W, int(k - first)}, pair.a[k], pair.b[k], out);
    }
  });
}

static void clearance(const Tables& tables, const States& states, double far, double* out, double* gradient) {
  const size_t nq = size_t(tables.n_joint);
  const float limit = far < 1e9 ? float(far) : 1e9f;
  for_each_block<F>(tables, states, [&](size_t first, int count, const Frame<F>* X_W) {
    const Nearest pair = nearest(tables, X_W, limit);
    for (int i = 0; i < count; ++i) {
      const bool known = is_number(states.q + (first + size_t(i)) * nq, nq);
      out[first + size_t(i)] = !known            ? __builtin_nan("")
                               : pair.a[i] == -1 ? __builtin_inf()
                                                 : double(pair.distance[i]);
    }
    const States block{states.q + first * nq, nullptr, size_t(count)};
    if (!gradient) return;
    if (any(pair.a != -1)) return clearance_gradients(tables, pair, block, gradient + first * nq);
    for (size_t i = 0; i < block.n * nq; ++i) gradient[first * nq + i] = 0;
  });
}

static void interaction(const Tables& tables, const States& states, double* probability) {
  const size_t stride = size_t(tables.n_component) * size_t(tables.n_entity);
  for_each_block<D>(tables, states, [&](size_t first, int count, const Frame<D>* X_W) {
    for_each_interaction(tables, X_W, CountedComponents(tables, nullptr), [&](int r, int e, D P) {
      for (int i = 0; i < count; ++i)
        probability[(first + size_t(i)) * stride + size_t(r * tables.n_entity + e)] = P[i];
    });
  });
}

static void impact(const Tables& tables, const double* severity, const States& states, double* out) {
  const size_t n = states.n;
  D qs[kMaxJoints];
  const CountedComponents counted(tables, severity);
  for (size_t first = 0; first < n; first += kLanes<double>) {
    load(tables, states.q, first, n, qs);
    const D value = impact_of(tables, counted, qs);
    for (int i = 0; i < kLanes<double> && first + size_t(i) < n; ++i) out[first + size_t(i)] = value[i];
  }
}

// V = length, S = integral of the impact over length by the trapezoid rule, with samples at most `step` apart.
template <class Value>
static inline void edge_cost(const Tables& tables, const double* a, const double* b, double step, Value impact_at,
                             double* cost) {
  constexpr int W = kLanes<double>;
  D qs[kMaxJoints], lane;
  for (int i = 0; i < W; ++i) lane[i] = double(i);
  const double length = distance(tables, a, b), pieces = length / step;
  if (!(pieces <= kMostPieces)) {
    cost[0] = length, cost[1] = __builtin_inf();
    return;
  }
  const int n_block = int((pieces + 1.0) / W) + 1, last = n_block * W - 1;
  double sum = 0;
  if (length > 0)
    for (int block = 0; block < n_block; ++block) {
      interpolate<double>(tables, a, b, (lane + double(block * W)) * (1.0 / last), qs);
      const D value = impact_at(qs);
      for (int i = 0; i < W; ++i) sum += value[i];
      if (block == 0) sum -= 0.5 * value[0];
      if (block == n_block - 1) sum -= 0.5 * value[W - 1];
    }
  cost[0] = length;
  cost[1] = length * sum / last;
}

static void edge_costs(const Tables& tables, const double* severity, const Edges& edges, double* cost) {
  const CountedComponents counted(tables, severity);
  const size_t nq = size_t(tables.n_joint);
  const auto impact_at = [&](const D* q) { return impact_of(tables, counted, q); };
  for (size_t k = 0; k < edges.n; ++k)
    edge_cost(tables, edges.q0 + k * nq, edges.q1 + k * nq, edges.step, impact_at, cost + 2 * k);
}

// Costs of edges travelled at shares (pace) of the velocity at which their slowest joint reaches its speed; samples
// alternate between the two shares. speed(j) is the speed of a joint, impact_at(q, qd) the integrand.
template <class Speed, class Value>
static inline void paced_edge_costs(const Tables& tables, const double* pace, const Edges& edges, Speed speed,
                                    Value impact_at, double* cost) {
  D rates[kMaxJoints], share;
  for (int i = 0; i < kLanes<double>; ++i) share[i] = pace[i % 2];
  const size_t nq = size_t(tables.n_joint);
  for (size_t k = 0; k < edges.n; ++k) {
    const double *a = edges.q0 + k * nq, *b = edges.q1 + k * nq;
    double duration = 0;
    for (size_t j = 0; j < nq; ++j) {
      const double seconds = __builtin_fabs(b[j] - a[j]) / speed(j);
      duration = seconds > duration ? seconds : duration;
    }
    for (size_t j = 0; j < nq; ++j) rates[j] = share * (duration > 0 ? (b[j] - a[j]) / duration : 0.0);
    edge_cost(tables, a, b, edges.step, [&](const D* q) { return impact_at(q, rates); }, cost + 2 * k);
  }
}

// --- the drop model -------------------------------------------------------------------------------------------------

static void drop(const Tables& tables, const DropTables& drop, const States& states, double* probability) {
  D P[kDropRows * kMaxEntities + 1];
  const size_t count = size_t(kDropRows * drop.n_entity + 1);
  for_each_release<D>(tables, states, [&](size_t first, const D* qs, const D* rates) {
    drop_probability(tables, drop, nullptr, qs, rates, P);
    for (int i = 0; i < kAbreast<D> && first + size_t(i) < states.n; ++i)
      for (size_t e = 0; e < count; ++e) probability[(first + size_t(i)) * count + e] = P[e][i];
  });
}

static void drop_sights(const Tables& tables, const DropTables& drop, const States& states, double* out) {
  const size_t count = size_t(kNetworkInputs + 1), row = count * size_t(drop.n_surface);
  for_each_release<D>(tables, states, [&](size_t first, const D* qs, const D* rates) {
    const Fall<D> fall(tables, drop, qs, rates);
    for_each_hit(drop, fall.flight, fall.landing, [&](int k, const Leaving<D>& leaving, const Hits<D>& hits, D lower) {
      const Sight<D> sight(drop, fall.flight, fall.landing, leaving, drop.surface[k], hits, lower);
      const D P = hits.any_of_them();
      for (int i = 0; i < kAbreast<D> && first + size_t(i) < states.n; ++i) {
        double* own = out + (first + size_t(i)) * row + size_t(k) * count;
        for (int f = 0; f < kNetworkInputs; ++f) own[f] = sight.told[f][i];
        own[kNetworkInputs] = P[i];
      }
    });
  });
}

static void drop_edge_costs(const Tables& tables, const DropTables& drop, const double* severity, const double* pace,
                            const Edges& edges, double* cost) {
  const auto impact_at = [&](const D* q, const D* qd) { return drop_impact_of(tables, drop, severity, q, qd); };
  paced_edge_costs(tables, pace, edges, [&](size_t j) { return drop.speed[j]; }, impact_at, cost);
}

// --- the body model -------------------------------------------------------------------------------------------------

static void body(const Tables& tables, const BodyTables& body, const States& states, const double* ahead,
                 double* distance) {
  const size_t n = states.n;
  D qs[kMaxJoints], rates[kMaxJoints];
  auto* room = new Arm<D>(tables, body, {});
  Arm<D>& arm = *room;
  const size_t row = size_t(body.n_entity), mode_size = size_t(body.n_row) * row,
               state = size_t(2 * tables.n_joint + 2) * mode_size;
  for (size_t first = 0; first < n; first += kLanes<double>) {
    load(tables, states.q, first, n, qs);
    load(tables, states.qd, first, n, rates);
    arm.start(qs, rates, ahead, first, n);
    arm.fail(rates, [&](int mode, int) {
      for (int r = 0; r < body.n_row; ++r)
        for (int e = 0; e < body.n_entity; ++e) {
          const D d = arm.way.best[r][e];
          for (int i = 0; i < kLanes<double> && first + size_t(i) < n; ++i)
            distance[(first + size_t(i)) * state + size_t(mode) * mode_size + size_t(r) * row + size_t(e)] = d[i];
        }
    });
  }
  delete room;
}

static void body_impact(const Tables& tables, const BodyTables& body, const BodyHarm& harm, const States& states,
                        double* out) {
  const size_t n = states.n;
  F qs[kMaxJoints], rates[kMaxJoints] = {};
  auto* room = new Arm<F>(tables, body, harm);
  for (size_t first = 0; first < n; first += kLanes<float>) {
    load(tables, states.q, first, n, qs);
    if (states.qd) load(tables, states.qd, first, n, rates);
    const F value = body_impact_of(*room, qs, rates);
    for (int i = 0; i < kLanes<float> && first + size_t(i) < n; ++i) out[first + size_t(i)] = double(value[i]);
  }
  delete room;
}

static void body_gradient(const Tables& tables, const BodyTables& body, const BodyHarm& harm, const States& states,
                          const Slopes& out) {
  const size_t n = states.n, nq = size_t(tables.n_joint);
  F qs[kMaxJoints], rates[kMaxJoints] = {};
  auto* arm = new Arm<F, true>(tables, body, harm);
  auto* slopes = new BodySlopes<F>(*arm);
  for (size_t first = 0; first < n; first += kLanes<float>) {
    load(tables, states.q, first, n, qs);
    if (states.qd) load(tables, states.qd, first, n, rates);
    slopes->run(qs, rates);
    for (int i = 0; i < kLanes<float> && first + size_t(i) < n; ++i) {
      const size_t row = first + size_t(i);
      out.value[row] = double(slopes->impact[i]);
      for (size_t j = 0; j < nq; ++j)
        out.d_q[row * nq + j] = double(slopes->d_q[j][i]), out.d_qd[row * nq + j] = double(slopes->d_qd[j][i]);
    }
  }
  delete slopes, delete arm;
}

// Mass matrix and gravity torques, for tests.
static void body_dynamics(const Tables& tables, const BodyTables& body, const States& states, double* mass_matrix,
                          double* gravity) {
  D M[kMaxJoints][kMaxJoints], g[kMaxJoints];
  const size_t nq = size_t(tables.n_joint);
  for_each_block<D>(tables, states, [&](size_t first, int count, const Frame<D>* X_W) {
    mass_and_weight(tables, body, X_W, M, g);
    for (int i = 0; i < count; ++i)
      for (size_t a = 0, row = first + size_t(i); a < nq; ++a) {
        gravity[row * nq + a] = g[a][i];
        for (size_t b = 0; b < nq; ++b) mass_matrix[(row * nq + a) * nq + b] = M[a][b][i];
      }
  });
}

// e^x and ln e^x as the drop model computes them, for tests.
static void elementary(const double* x, size_t n, double* exponentials, double* logarithms) {
  for (size_t first = 0; first < n; first += kLanes<double>) {
    D value = {};
    const size_t count = n - first < size_t(kLanes<double>) ? n - first : size_t(kLanes<double>);
    for (size_t i = 0; i < count; ++i) value[i] = x[first + i];
    const D e = exponential(value), l = logarithm(e);
    for (size_t i = 0; i < count; ++i) exponentials[first + i] = e[i], logarithms[first + i] = l[i];
  }
}

}  // namespace GP_ISA

#define GP_JOIN_(a, b) a##b
#define GP_JOIN(a, b) GP_JOIN_(a, b)
extern const Kernels GP_JOIN(kernels_, GP_ISA) = {
    .lanes = GP_ISA::kLanes<float>,
    .link_poses = GP_ISA::link_poses,
    .free_states = GP_ISA::free_states,
    .free_edges = GP_ISA::free_edges,
    .clearance = GP_ISA::clearance,
    .interaction = GP_ISA::interaction,
    .reach = GP_ISA::reach,
    .impact = GP_ISA::impact,
    .edge_costs = GP_ISA::edge_costs,
    .drop = GP_ISA::drop,
    .drop_sights = GP_ISA::drop_sights,
    .drop_impact = GP_ISA::drop_impact<GP_ISA::D>,
    .drop_gradient = GP_ISA::drop_gradient<GP_ISA::D>,
    .drop_edge_costs = GP_ISA::drop_edge_costs,
    .rough_drop_impact = GP_ISA::drop_impact<GP_ISA::Single>,
    .rough_drop_gradient = GP_ISA::drop_gradient<GP_ISA::Single>,
    .body = GP_ISA::body,
    .body_impact = GP_ISA::body_impact,
    .body_gradient = GP_ISA::body_gradient,
    .body_dynamics = GP_ISA::body_dynamics,
    .moving_drop = GP_ISA::moving::drop_probability,
    .moving_drop_gradient = GP_ISA::moving::drop_gradient,
    .moving_arm = GP_ISA::moving::arm_probability,
    .moving_arm_gradient = GP_ISA::moving::arm_gradient,
    .moving_gaps = GP_ISA::moving::gaps,
    .elementary = GP_ISA::elementary,
};

}  // namespace gp
