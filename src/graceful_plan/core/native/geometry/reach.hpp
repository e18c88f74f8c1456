// Inverse kinematics by damped least squares, W seeds side by side. A finished lane takes the next seed, so seeds do
// not affect each other.
//
// A seed may aim at a set of poses around its pose: within a distance and within an angle. With the offset e from the
// tool to the pose and the radius r of the set, what is missing is e (1 - r/|e|), or 0 inside. Across e its Jacobian is
// smaller by the factor 1 - r/|e|, since moving along the sphere changes nothing at its surface.
//
// C. W. Wampler, "Manipulator inverse kinematic solutions based on vector formulations and damped least-squares
// methods", IEEE Transactions on Systems, Man, and Cybernetics 16 (1986).
#pragma once
#include <cstddef>

#include "cutoffs.hpp"
#include "geometry/kinematics.hpp"
#include "lanes.hpp"
#include "single.hpp"
#include "tables.hpp"

namespace gp::GP_ISA {

constexpr double kReached = 1e-10;      // norm of the missing twist [m and rad] at which a seed has converged
constexpr double kFarDamping = 1e-2;    // damping = kFarDamping |missing|^2 + kLeastDamping: steady far from the pose,
constexpr double kLeastDamping = 1e-9;  // close to it as fast as Newton's method
constexpr double kLongestStep = 0.5;    // largest step of a joint in one iteration [rad or m]
constexpr double kProgress = 0.7;  // largest share of the missing twist that may remain after `patience` iterations
constexpr double kNoAngle = 1e-9;  // sine below which an angle counts as 0 or pi
constexpr double kHalfTurn = 3.14159265358979323846;
constexpr int kTwist = 6;  // translation [m] and rotation vector [rad], in W

// The seeds being solved, and the joints that move the tool.
struct Reaching {
  const Tables& tables;
  const Reach& ask;
  int n_mover = 0, mover[kMaxJoints] = {};  // links whose joints move the tool and are not held
  D q[kMaxJoints] = {}, goal[12] = {}, J[kMaxJoints][kTwist] = {}, missing[kTwist] = {}, norm = {};
  D radius[2] = {};  // of the set of poses: distance [m], angle [rad]
  Mask<double> free_yaw = {};

  Reaching(const Tables& t, const Reach& r) : tables(t), ask(r) {
    for (int l = ask.tool_link; l >= 0; l = tables.link[l].parent)
      if (tables.link[l].joint >= 0 && !ask.held[tables.link[l].joint]) mover[n_mover++] = l;
  }

  void begin(int lane, size_t seed) {
    for (int j = 0; j < tables.n_joint; ++j) q[j][lane] = ask.seed[seed * size_t(tables.n_joint) + size_t(j)];
    for (int k = 0; k < 12; ++k) goal[k][lane] = ask.X_WG[seed * 12 + size_t(k)];
    free_yaw[lane] = ask.free_yaw[seed] ? -1 : 0;
    for (int part = 0; part < 2; ++part) radius[part][lane] = ask.radius[2 * seed + size_t(part)];
  }

  // Computes the missing twist of every lane, and the Jacobian of the tool.
  void linearise() {
    Frame<D> X_W[kMaxLinks];
    forward_kinematics(tables, q, X_W);
    const Frame<D>& X = X_W[tables.link[ask.tool_link].frame];
    D R[9];
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k)
        R[3 * i + k] = X.R[3 * i] * ask.X_LT[k] + X.R[3 * i + 1] * ask.X_LT[4 + k] + X.R[3 * i + 2] * ask.X_LT[8 + k];
    const double tip[3] = {ask.X_LT[3], ask.X_LT[7], ask.X_LT[11]};
    const Vec<D> p = transform(X, tip);
    missing[0] = goal[3] - p.x, missing[1] = goal[7] - p.y, missing[2] = goal[11] - p.z;
    rotate_to(R);
    const D z[3] = {R[2], R[5], R[8]};
    for (int m = 0; m < n_mover; ++m) {
      const Link& link = tables.link[mover[m]];
      const Frame<D>& joint = X_W[mover[m]];
      const D a[3] = {joint.R[2], joint.R[5], joint.R[8]}, r[3] = {p.x - joint.p.x, p.y - joint.p.y, p.z - joint.p.z};
      D along = z[0] * a[0] + z[1] * a[1] + z[2] * a[2];
      along = where(free_yaw, along, D{});
      for (int i = 0; i < 3; ++i) {
        const int k = (i + 1) % 3, l = (i + 2) % 3;
        J[m][i] = link.slide ? a[i] : a[k] * r[l] - a[l] * r[k];
        J[m][3 + i] = link.slide ? D{} : a[i] - along * z[i];
      }
    }
    for (int part = 0; part < 2; ++part)
      if (any(radius[part] > 0.0)) relax(missing + 3 * part, 3 * part, radius[part]);
    D squared = {};
    for (const D& part : missing) squared += part * part;
    norm = square_root(squared + kTiny<D>);
  }

  // Reduces an offset, and its rows of the Jacobian, to the part outside a ball of radius r.
  void relax(D e[3], int row, D r) {
    const D length = square_root(e[0] * e[0] + e[1] * e[1] + e[2] * e[2] + kTiny<D>), inverse = 1.0 / length;
    const D across = maximum(D{}, 1.0 - r * inverse), extra = where(length > r, 1.0 - across, D{});
    const D unit[3] = {e[0] * inverse, e[1] * inverse, e[2] * inverse};
    for (int m = 0; m < n_mover; ++m) {
      D* const column = J[m] + row;
      const D along = extra * (unit[0] * column[0] + unit[1] * column[1] + unit[2] * column[2]);
      for (int i = 0; i < 3; ++i) column[i] = across * column[i] + along * unit[i];
    }
    for (int i = 0; i < 3; ++i) e[i] *= across;
  }

  // Computes the rotation vector from the tool's axes to the goal's, or from z axis to z axis if yaw is free.
  void rotate_to(const D R[9]) {
    const auto& g = goal;
    D sine[3] = {}, trace = {};
    for (int i = 0; i < 3; ++i) {
      const int k = (i + 1) % 3, l = (i + 2) % 3;
      D lk = {}, kl = {};  // entries of the relative rotation matrix
      for (int c = 0; c < 3; ++c) {
        lk += g[4 * l + c] * R[3 * k + c], kl += g[4 * k + c] * R[3 * l + c];
        trace += g[4 * i + c] * R[3 * i + c];
      }
      sine[i] = where(free_yaw, R[3 * k + 2] * g[4 * l + 2] - R[3 * l + 2] * g[4 * k + 2], 0.5 * (lk - kl));
    }
    const D cosine = where(free_yaw, R[2] * g[2] + R[5] * g[6] + R[8] * g[10], 0.5 * (trace - 1.0));
    const D length = square_root(sine[0] * sine[0] + sine[1] * sine[1] + sine[2] * sine[2] + kTiny<D>);
    D scale = D{} + 1.0;
    for (int i = 0; i < kLanes<double>; ++i) {
      if (length[i] > kNoAngle)
        scale[i] = __builtin_atan2(length[i], cosine[i]) / length[i];
      else if (cosine[i] < 0)
        sine[0][i] = kHalfTurn, sine[1][i] = sine[2][i] = 0;  // about x, since any axis will do
    }
    for (int i = 0; i < 3; ++i) missing[3 + i] = scale * sine[i];
  }

  double ease(int m) const { return ask.ease[tables.link[mover[m]].joint]; }

  // The damped step without the blocked joints, scaled so that no joint moves more than `kLongestStep`.
  void step(const Mask<double>* blocked, D* out) const {
    D gram[kTwist][kTwist] = {}, y[kTwist];
    const D damping = kFarDamping * norm * norm + kLeastDamping;
    for (int m = 0; m < n_mover; ++m)
      for (int i = 0; i < kTwist; ++i) {
        const D own = where(blocked[m], D{}, J[m][i]) * ease(m);
        for (int k = 0; k <= i; ++k) gram[i][k] += own * J[m][k];
      }
    // Cholesky factor L of gram = L L^T; the diagonal holds its inverses.
    for (int i = 0; i < kTwist; ++i) {
      for (int k = 0; k <= i; ++k) {
        D left = gram[i][k] + (k == i ? damping : D{});
        for (int c = 0; c < k; ++c) left -= gram[i][c] * gram[k][c];
        gram[i][k] = k < i ? left * gram[k][k] : inverse_root(maximum(left, D{} + kTiny<D>));
      }
    }
    for (int i = 0; i < kTwist; ++i) {
      y[i] = missing[i];
      for (int c = 0; c < i; ++c) y[i] -= gram[i][c] * y[c];
      y[i] *= gram[i][i];
    }
    for (int i = kTwist - 1; i >= 0; --i) {
      for (int c = i + 1; c < kTwist; ++c) y[i] -= gram[c][i] * y[c];
      y[i] *= gram[i][i];
    }
    D longest = {};
    for (int m = 0; m < n_mover; ++m) {
      out[m] = D{};
      for (int i = 0; i < kTwist; ++i) out[m] += J[m][i] * y[i];
      out[m] = where(blocked[m], D{}, out[m]) * ease(m);
      longest = maximum(longest, absolute(out[m]));
    }
    const D scale = minimum(D{} + 1.0, kLongestStep / maximum(longest, D{} + kTiny<D>));
    for (int m = 0; m < n_mover; ++m) out[m] *= scale;
  }

  // Steps the lanes that are going. Joints that would leave their limits stay, and the others compensate.
  void advance(Mask<double> going) {
    Mask<double> blocked[kMaxJoints] = {}, any_blocked = {};
    D moved[kMaxJoints];
    step(blocked, moved);
    for (int m = 0; m < n_mover; ++m) {
      const int j = tables.link[mover[m]].joint;
      const D end = q[j] + moved[m];
      blocked[m] = ((end < ask.lower[j]) & (moved[m] < 0.0)) | ((end > ask.upper[j]) & (moved[m] > 0.0));
      any_blocked |= blocked[m];
    }
    if (any(any_blocked)) step(blocked, moved);
    for (int m = 0; m < n_mover; ++m) {
      const int j = tables.link[mover[m]].joint;
      const D end = minimum(maximum(q[j] + moved[m], D{} + ask.lower[j]), D{} + ask.upper[j]);
      q[j] = where(going, end, q[j]);
    }
  }
};

static void reach(const Tables& tables, const Reach& ask, double* q, double* missing) {
  if (ask.n == 0) return;
  constexpr int W = kLanes<double>;
  constexpr size_t kNone = ~size_t(0);
  Reaching now(tables, ask);
  size_t seed[W], next = 0, nq = size_t(tables.n_joint);
  int spent[W];
  double past[W];
  const auto take = [&](int lane) {
    seed[lane] = next < ask.n ? next++ : kNone, spent[lane] = 0, past[lane] = __builtin_inf();
    if (seed[lane] != kNone) now.begin(lane, seed[lane]);
  };
  for (int i = 0; i < W; ++i) now.begin(i, 0), take(i);
  for (;;) {
    now.linearise();
    Mask<double> going = {};
    bool left = false;
    for (int i = 0; i < W; ++i) {
      if (seed[i] == kNone) continue;
      left = true;
      bool over = now.norm[i] <= kReached || spent[i] == ask.iterations;
      if (spent[i] % ask.patience == ask.patience - 1) {
        over |= !(now.norm[i] < kProgress * past[i]);
        past[i] = now.norm[i];
      }
      ++spent[i];
      going[i] = over ? 0 : -1;
      if (!over) continue;
      for (size_t j = 0; j < nq; ++j) q[seed[i] * nq + j] = now.q[j][i];
      for (size_t k = 0; k < kTwist; ++k) missing[seed[i] * kTwist + k] = now.missing[k][i];
      take(i);  // its twist is not known yet, so its first step follows in the next iteration
    }
    if (!left) return;
    now.advance(going);
  }
}

}  // namespace gp::GP_ISA
