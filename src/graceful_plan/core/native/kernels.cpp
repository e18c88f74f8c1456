// The kernels of one instruction set. This file is compiled several times; GP_ISA names the result. It uses no inline
// function of any other header, so that the linker cannot mix code of different instruction sets.
#include "tables.hpp"

#if defined(__x86_64__)
#include <algorithm>
#include <immintrin.h>
#endif

namespace gp {
namespace GP_ISA {

#include "lanes.hpp"
#include "single.hpp"
#include "geometry/kinematics.hpp"
#include "geometry/clearance.hpp"
#include "geometry/gradient.hpp"
#include "impact/interaction.hpp"

constexpr double kTail = 29.0;        // scales of noise beyond which nothing happens: e^-29 is 3e-13
constexpr double kHeld = 60.0;        // exponents are held within
constexpr double kNothing = 1e-13;    // a probability that does not matter
constexpr double kTiny = 1e-300;
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/spill.hpp"
#include "impact/spill_gradient.hpp"
#include "impact/impact_of_drop.hpp"
#include "impact/body.hpp"

// The drop model in single precision, with shorter tails.
namespace rough {
using D = Single;
constexpr double kTail = 14.0, kHeld = 16.0, kNothing = 1e-6, kTiny = 1e-30;  // products of five e^kHeld are finite
#include "impact/drop.hpp"
#include "impact/drop_gradient.hpp"
#include "impact/spill.hpp"
#include "impact/spill_gradient.hpp"
#include "impact/impact_of_drop.hpp"
}  // namespace rough

static void link_poses(const Tables& tables, const double* q, size_t n, double* X_WL) {
  D qs[kMaxJoints];
  Frame<D> X_W[kMaxLinks];
  for (size_t first = 0; first < n; first += kLanes<double>) {
    load(tables, q, first, n, qs);
    forward_kinematics(tables, qs, X_W);
    for (int i = 0; i < kLanes<double> && first + size_t(i) < n; ++i)
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
  }
}

static void free_states(const Tables& tables, const double* q, size_t n, double margin, uint8_t* free) {
  F qs[kMaxJoints];
  Frame<F> X_W[kMaxLinks];
  for (size_t first = 0; first < n; first += kLanes<float>) {
    load(tables, q, first, n, qs);
    forward_kinematics(tables, qs, X_W);
    MaskF hit = collides<false>(tables, X_W, float(margin));
    for (int i = 0; i < kLanes<float> && first + size_t(i) < n; ++i) free[first + size_t(i)] = !hit[i];
  }
}

// Blocks are spread over the whole edge and shifted between each other, so that a bad edge fails in the first ones.
static bool edge_is_free(const Tables& tables, const double* q0, const double* q1, double step, float margin) {
  constexpr int W = kLanes<float>;
  F qs[kMaxJoints], lane;
  Frame<F> X_W[kMaxLinks];
  for (int i = 0; i < W; ++i) lane[i] = float(i);
  const int n_block = int((distance(tables, q0, q1) / step + 1.0) / W) + 1;
  const float spacing = 1.f / float(W * n_block - 1);
  for (int b = 0; b < n_block; ++b) {
    interpolate<float>(tables, q0, q1, (lane * float(n_block) + float(b)) * spacing, qs);
    forward_kinematics(tables, qs, X_W);
    if (any(collides<true>(tables, X_W, margin))) return false;
  }
  return true;
}

static void free_edges(const Tables& tables, const double* q0, const double* q1, size_t n, double step, double margin, uint8_t* free) {
  for (size_t k = 0; k < n; ++k)
    free[k] = edge_is_free(tables, q0 + k * size_t(tables.n_joint), q1 + k * size_t(tables.n_joint), step, float(margin));
}

// Those of one block of lanes of `clearance`, whose pairs are known; between near spheres single precision is too coarse.
static void clearance_gradients(const Tables& tables, const Nearest& pair, const double* q, size_t first, size_t n, double* gradient) {
  D qs[kMaxJoints];
  Frame<D> X_W[kMaxLinks];
  for (int done = 0; done < kLanes<float> && first + size_t(done) < n; done += kLanes<double>) {
    load(tables, q, first + size_t(done), n, qs);
    forward_kinematics(tables, qs, X_W);
    for (int i = 0; i < kLanes<double> && first + size_t(done + i) < n; ++i)
      clearance_gradient(tables, X_W, pair.a[done + i], pair.b[done + i], i, gradient + (first + size_t(done + i)) * size_t(tables.n_joint));
  }
}

static void clearance(const Tables& tables, const double* q, size_t n, double* out, double* gradient) {
  F qs[kMaxJoints];
  Frame<F> X_W[kMaxLinks];
  for (size_t first = 0; first < n; first += kLanes<float>) {
    load(tables, q, first, n, qs);
    forward_kinematics(tables, qs, X_W);
    const Nearest pair = nearest(tables, X_W);
    for (int i = 0; i < kLanes<float> && first + size_t(i) < n; ++i)
      out[first + size_t(i)] = pair.a[i] < 0 ? __builtin_inf() : double(pair.distance[i]);
    if (gradient) clearance_gradients(tables, pair, q, first, n, gradient);
  }
}

static void interaction(const Tables& tables, const double* q, size_t n, double* probability) {
  D qs[kMaxJoints];
  Frame<D> X_W[kMaxLinks];
  const size_t stride = size_t(tables.n_component) * size_t(tables.n_entity);
  for (size_t first = 0; first < n; first += kLanes<double>) {
    load(tables, q, first, n, qs);
    forward_kinematics(tables, qs, X_W);
    for_each_interaction(tables, X_W, Hazard(tables, nullptr), [&](int r, int e, D P) {
      for (int i = 0; i < kLanes<double> && first + size_t(i) < n; ++i)
        probability[(first + size_t(i)) * stride + size_t(r * tables.n_entity + e)] = P[i];
    });
  }
}

static void impact(const Tables& tables, const double* severity, const double* q, size_t n, double* out) {
  D qs[kMaxJoints];
  const Hazard hazard(tables, severity);
  for (size_t first = 0; first < n; first += kLanes<double>) {
    load(tables, q, first, n, qs);
    const D value = impact_of(tables, hazard, qs);
    for (int i = 0; i < kLanes<double> && first + size_t(i) < n; ++i) out[first + size_t(i)] = value[i];
  }
}

// V = length, S = integral of the impact over length by the trapezoid rule, at least every `step`.
template <class Value>
static inline void edge_cost(const Tables& tables, const double* a, const double* b, double step, Value impact_at, double* cost) {
  constexpr int W = kLanes<double>;
  D qs[kMaxJoints], lane;
  for (int i = 0; i < W; ++i) lane[i] = double(i);
  const double length = distance(tables, a, b);
  const int n_block = int((length / step + 1.0) / W) + 1, last = n_block * W - 1;
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

static void edge_costs(const Tables& tables, const double* severity, const double* q0, const double* q1, size_t n, double step, double* cost) {
  const Hazard hazard(tables, severity);
  const size_t nq = size_t(tables.n_joint);
  for (size_t k = 0; k < n; ++k)
    edge_cost(tables, q0 + k * nq, q1 + k * nq, step, [&](const D* q) { return impact_of(tables, hazard, q); }, cost + 2 * k);
}

// --- the drop model -------------------------------------------------------------------------------------------------

static void drop(const Tables& tables, const DropTables& drop, const double* q, const double* qd, size_t n, double* probability) {
  D P[kDropRows * kMaxEntities];
  const size_t count = size_t(kDropRows * drop.n_entity);
  for_each_release(tables, q, qd, n, [&](size_t first, const D* qs, const D* rates) {
    drop_probability(tables, drop, nullptr, qs, rates, P);
    for (int i = 0; i < kAbreast<D> && first + size_t(i) < n; ++i)
      for (size_t e = 0; e < count; ++e) probability[(first + size_t(i)) * count + e] = P[e][i];
  });
}

// The velocity is that of the edge: its slowest joint at a share of its speed, by turns the first and the second one.
static void drop_edge_costs(const Tables& tables, const DropTables& drop, const double* severity, const double* pace, const double* q0,
                            const double* q1, size_t n, double step, double* cost) {
  D rates[kMaxJoints], share;
  for (int i = 0; i < kLanes<double>; ++i) share[i] = pace[i % 2];
  const size_t nq = size_t(tables.n_joint);
  for (size_t k = 0; k < n; ++k) {
    const double *a = q0 + k * nq, *b = q1 + k * nq;
    double duration = 0;
    for (size_t j = 0; j < nq; ++j) {
      const double seconds = __builtin_fabs(b[j] - a[j]) / drop.speed[j];
      duration = seconds > duration ? seconds : duration;
    }
    for (size_t j = 0; j < nq; ++j) rates[j] = share * (duration > 0 ? (b[j] - a[j]) / duration : 0.0);
    edge_cost(tables, a, b, step, [&](const D* q) { return drop_impact_of(tables, drop, severity, q, rates); }, cost + 2 * k);
  }
}

// --- the body model -------------------------------------------------------------------------------------------------

// An arm with room for its lists.
struct ArmRoom {
  Arm arm;

  ArmRoom(const Tables& tables, const BodyTables& body, const double* severity) : arm{tables, body, severity, {}, {}, {}, {}, {}, {}, {}, 0, 0, 0} {
    const size_t room = size_t(tables.n_group) * size_t(tables.n_obstacle) + 1;
    arm.around.near = new Near[room + size_t(tables.n_obstacle)];
    arm.around.scratch = arm.around.near + room;
    const size_t steps = size_t(body.n_step > body.n_reference ? body.n_step : body.n_reference) + 1;
    arm.around.distance = new D[steps * room];
    arm.around.known = new uint8_t[steps * room];
  }
  ArmRoom(const ArmRoom&) = delete;
  ~ArmRoom() { delete[] arm.around.near, delete[] arm.around.distance, delete[] arm.around.known; }
};

static void body(const Tables& tables, const BodyTables& body, const double* q, const double* qd, const double* ahead, size_t n,
                 double* distance) {
  D qs[kMaxJoints], rates[kMaxJoints];
  ArmRoom* room = new ArmRoom(tables, body, nullptr);
  const size_t row = size_t(body.n_entity), mode_size = size_t(body.n_row) * row, state = size_t(2 * tables.n_joint + 2) * mode_size;
  for (size_t first = 0; first < n; first += kLanes<double>) {
    load(tables, q, first, n, qs);
    load(tables, qd, first, n, rates);
    room->arm.begin(qs, rates, ahead, first, n);
    room->arm.fail(rates, nullptr, [&](int mode, int) {
      for (int r = 0; r < body.n_row; ++r)
        for (int e = 0; e < body.n_entity; ++e) {
          const D d = room->arm.way.best[r][e];
          for (int i = 0; i < kLanes<double> && first + size_t(i) < n; ++i)
            distance[(first + size_t(i)) * state + size_t(mode) * mode_size + size_t(r) * row + size_t(e)] = d[i];
        }
    });
  }
  delete room;
}

static void body_impact(const Tables& tables, const BodyTables& body, const double* weight, const double* severity, const double* q,
                        const double* qd, size_t n, double* out) {
  D qs[kMaxJoints], rates[kMaxJoints] = {};
  ArmRoom* room = new ArmRoom(tables, body, severity);
  for (size_t first = 0; first < n; first += kLanes<double>) {
    load(tables, q, first, n, qs);
    if (qd) load(tables, qd, first, n, rates);
    const D value = body_impact_of(room->arm, weight, qs, rates);
    for (int i = 0; i < kLanes<double> && first + size_t(i) < n; ++i) out[first + size_t(i)] = value[i];
  }
  delete room;
}

// The velocity is that of the edge, as in the drop model.
static void body_edge_costs(const Tables& tables, const BodyTables& body, const double* weight, const double* severity, const double* pace,
                            const double* q0, const double* q1, size_t n, double step, double* cost) {
  D rates[kMaxJoints], share;
  for (int i = 0; i < kLanes<double>; ++i) share[i] = pace[i % 2];
  const size_t nq = size_t(tables.n_joint);
  ArmRoom* room = new ArmRoom(tables, body, severity);
  for (size_t k = 0; k < n; ++k) {
    const double *a = q0 + k * nq, *b = q1 + k * nq;
    double duration = 0;
    for (size_t j = 0; j < nq; ++j) {
      const double seconds = __builtin_fabs(b[j] - a[j]) / body.drive[j].speed;
      duration = seconds > duration ? seconds : duration;
    }
    for (size_t j = 0; j < nq; ++j) rates[j] = share * (duration > 0 ? (b[j] - a[j]) / duration : 0.0);
    edge_cost(tables, a, b, step, [&](const D* q) { return body_impact_of(room->arm, weight, q, rates); }, cost + 2 * k);
  }
  delete room;
}

// Mass matrix and torques of the weight, for tests.
static void body_dynamics(const Tables& tables, const BodyTables& body, const double* q, size_t n, double* mass_matrix, double* gravity) {
  D qs[kMaxJoints], M[kMaxJoints][kMaxJoints], g[kMaxJoints];
  Frame<D> X_W[kMaxLinks];
  const size_t nq = size_t(tables.n_joint);
  for (size_t first = 0; first < n; first += kLanes<double>) {
    load(tables, q, first, n, qs);
    forward_kinematics(tables, qs, X_W);
    mass_and_weight(tables, body, X_W, M, g);
    for (size_t i = 0; i < size_t(kLanes<double>) && first + i < n; ++i)
      for (size_t a = 0; a < nq; ++a) {
        gravity[(first + i) * nq + a] = g[a][int(i)];
        for (size_t b = 0; b < nq; ++b) mass_matrix[((first + i) * nq + a) * nq + b] = M[a][b][int(i)];
      }
  }
}

// e^x and ln e^x, for tests of what the drop model computes itself.
static void elementary(const double* x, size_t n, double* exponentials, double* logarithms) {
  for (size_t first = 0; first < n; first += kLanes<double>) {
    D value = {};
    const size_t count = n - first < size_t(kLanes<double>) ? n - first : size_t(kLanes<double>);
    for (size_t i = 0; i < count; ++i) value[i] = x[first + i];
    const D e = exponential(value), l = logarithm(e);
    for (size_t i = 0; i < count; ++i) exponentials[first + i] = e[i], logarithms[first + i] = l[i];
  }
}

#define GP_TEXT_(x) #x
#define GP_TEXT(x) GP_TEXT_(x)
}  // namespace GP_ISA

#define GP_JOIN_(a, b) a##b
#define GP_JOIN(a, b) GP_JOIN_(a, b)
extern const Kernels GP_JOIN(kernels_, GP_ISA) = {GP_TEXT(GP_ISA),   GP_ISA::kLanes<float>, GP_ISA::link_poses,
                                                 GP_ISA::free_states, GP_ISA::free_edges,   GP_ISA::clearance,
                                                 GP_ISA::interaction, GP_ISA::impact,       GP_ISA::edge_costs,
                                                 GP_ISA::drop,        GP_ISA::drop_impact,  GP_ISA::drop_gradient,
                                                 GP_ISA::drop_edge_costs, GP_ISA::rough::drop_impact, GP_ISA::rough::drop_gradient, GP_ISA::body,      GP_ISA::body_impact,
                                                 GP_ISA::body_edge_costs, GP_ISA::body_dynamics, GP_ISA::elementary};

}  // namespace gp
