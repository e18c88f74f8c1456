// Shortest curves of a car: forward and backward (J. A. Reeds, L. A. Shepp, "Optimal paths for a car that goes both
// forwards and backwards", Pacific J. Math. 145, 1990; the 48 words, equations 8.1 to 8.11 there, with the corrections
// that OMPL documents), forward only (L. E. Dubins, 1957), and for a base that turns in place: turn, straight, turn.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

namespace gp::lattice {

constexpr double kPi = std::numbers::pi;
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Pose {
  double x, y, yaw;
};

// A piece driven with one steering angle: length [m], negative backwards, and curvature [1/m], positive to the left;
// or, with length 0, a turn in place [rad].
struct Piece {
  double length = 0.0, curvature = 0.0, turn = 0.0;
};

struct Curve {
  std::array<Piece, 5> pieces;
  int n = 0;
  double cost = kInfinity;
};

inline double wrapped(double angle) {
  angle = std::fmod(angle, 2.0 * kPi);
  return angle < -kPi ? angle + 2.0 * kPi : angle > kPi ? angle - 2.0 * kPi : angle;
}

inline Pose moved(const Pose& from, const Piece& piece, double share) {
  if (piece.length == 0.0) return {from.x, from.y, from.yaw + share * piece.turn};
  const double s = share * piece.length, bend = s * piece.curvature;
  // The chord at the mean heading avoids cancellation at small curvature.
  const double half = 0.5 * bend, chord = std::abs(half) < 1e-9 ? s : s * std::sin(half) / half;
  return {from.x + chord * std::cos(from.yaw + half), from.y + chord * std::sin(from.yaw + half), from.yaw + bend};
}

inline Pose end_of(Pose pose, const Piece* pieces, int n) {
  for (int i = 0; i < n; ++i) pose = moved(pose, pieces[i], 1.0);
  return pose;
}

namespace words {

// Signed arcs and straights in units of the radius; L, S, R give the steering of each.
struct Word {
  std::array<double, 5> part{};
  const char* steer = "";
  bool mirrored = false;
  double length = kInfinity, cost = kInfinity;
};

constexpr double kZero = 1e-14;  // rounding of lengths in units of the turning radius

class ReedsShepp {
 public:
  // The word with the least cost if driving backwards costs `penalty` times as much.
  ReedsShepp(double x, double y, double phi, double penalty) : penalty_(penalty) {
    const double xb = x * std::cos(phi) + y * std::sin(phi), yb = x * std::sin(phi) - y * std::cos(phi);
    for (int k = 0; k < 4; ++k) {
      const double sx = k & 1 ? -1.0 : 1.0, sy = k & 2 ? -1.0 : 1.0;  // time flipped, mirrored
      flip_ = sx, mirrored_ = k & 2;
      forth(sx * x, sy * y, sx * sy * phi);
      back(sx * xb, sy * yb, sx * sy * phi);
    }
  }
  const Word& best() const { return best_; }

 private:
  void offer(const char* steer, std::array<double, 5> part) {
    double length = 0.0, cost = 0.0;
    for (double& p : part) {
      length += std::abs(p), p *= flip_;
      cost += p < 0.0 ? -penalty_ * p : p;
    }
    if (cost < best_.cost) best_ = {part, steer, mirrored_, length, cost};
  }
  void forth(double x, double y, double phi) {
    const double c = std::cos(phi), s = std::sin(phi), quarter = 0.5 * kPi;
    double xi = x - s, eta = y - 1.0 + c, rho = std::hypot(xi, eta), theta = std::atan2(eta, xi);
    if (theta >= -kZero) {  // L+ S+ L+
      const double v = wrapped(phi - theta);
      if (v >= -kZero) offer("LSL", {theta, rho, v});
    }
    left_right_left(xi, eta, phi, false);
    if (rho >= 2.0) {  // L+ R- S- L-
      const double r = std::sqrt(rho * rho - 4.0), u = 2.0 - r, t = wrapped(theta + std::atan2(r, -2.0));
      const double v = wrapped(phi - quarter - t);
      if (t >= -kZero && u <= kZero && v <= kZero) offer("LRSL", {t, -quarter, u, v});
    }
    xi = x + s, eta = y - 1.0 - c, rho = std::hypot(xi, eta), theta = std::atan2(eta, xi);
    if (rho >= 2.0) {
      const double u = std::sqrt(rho * rho - 4.0), t = wrapped(theta + std::atan2(2.0, u)), v = wrapped(t - phi);
      if (t >= -kZero && v >= -kZero) offer("LSR", {t, u, v});  // L+ S+ R+
      right_straight_right(xi, eta, rho, phi, false);
      const double w = 4.0 - u;
      if (w <= kZero) {  // L+ R- S- L- R+
        const double a = wrapped(std::atan2((4.0 - w) * xi - 2.0 * eta, -2.0 * xi + (w - 4.0) * eta));
        const double b = wrapped(a - phi);
        if (a >= -kZero && b >= -kZero) offer("LRSLR", {a, -quarter, w, -quarter, b});
      }
    }
    four_arcs(xi, eta, rho, phi);
  }
  // The same words, driven from the end.
  void back(double x, double y, double phi) {
    const double c = std::cos(phi), s = std::sin(phi), quarter = 0.5 * kPi;
    double xi = x - s, eta = y - 1.0 + c, rho = std::hypot(xi, eta), theta = std::atan2(eta, xi);
    left_right_left(xi, eta, phi, true);
    if (rho >= 2.0) {
      const double r = std::sqrt(rho * rho - 4.0), u = 2.0 - r, t = wrapped(theta + std::atan2(r, -2.0));
      const double v = wrapped(phi - quarter - t);
      if (t >= -kZero && u <= kZero && v <= kZero) offer("LSRL", {v, u, -quarter, t});
    }
    xi = x + s, eta = y - 1.0 - c, rho = std::hypot(xi, eta);
    if (rho >= 2.0) right_straight_right(xi, eta, rho, phi, true);
  }
  void left_right_left(double xi, double eta, double phi, bool back) {  // L+ R- L
    const double rho = std::hypot(xi, eta), theta = std::atan2(eta, xi);
    if (rho > 4.0) return;
    const double u = -2.0 * std::asin(0.25 * rho), t = wrapped(theta + 0.5 * u + kPi), v = wrapped(phi - t + u);
    if (t < -kZero || u > kZero) return;
    offer("LRL", back ? std::array<double, 5>{v, u, t} : std::array<double, 5>{t, u, v});
  }
  void right_straight_right(double xi, double eta, double rho, double phi, bool back) {  // L+ R- S- R-
    const double t = std::atan2(xi, -eta), u = 2.0 - rho, v = wrapped(t + 0.5 * kPi - phi);
    if (t < -kZero || u > kZero || v > kZero) return;
    if (back) {
      offer("RSRL", {v, u, -0.5 * kPi, t});
    } else {
      offer("LRSR", {t, -0.5 * kPi, u, v});
    }
  }
  void four_arcs(double xi, double eta, double rho, double phi) {
    double share = 0.25 * (2.0 + rho);
    if (share <= 1.0) {  // L+ R+ L- R-
      const double u = std::acos(share);
      const auto [t, v] = tau_omega(u, -u, {xi, eta, phi});
      if (t >= -kZero && v <= kZero) offer("LRLR", {t, u, -u, v});
    }
    share = (20.0 - rho * rho) / 16.0;
    if (share >= 0.0 && share <= 1.0) {  // L+ R- L- R+
      const double u = -std::acos(share);
      const auto [t, v] = tau_omega(u, u, {xi, eta, phi});
      if (t >= -kZero && v >= -kZero) offer("LRLR", {t, u, u, v});
    }
  }
  static std::pair<double, double> tau_omega(double u, double v, const Pose& at) {
    const double delta = wrapped(u - v), a = std::sin(u) - std::sin(delta), b = std::cos(u) - std::cos(delta) - 1.0;
    const double t1 = std::atan2(at.y * a - at.x * b, at.x * a + at.y * b);
    const double t2 = 2.0 * (std::cos(delta) - std::cos(v) - std::cos(u)) + 3.0;
    const double tau = wrapped(t2 < 0.0 ? t1 + kPi : t1);
    return {tau, wrapped(tau - u + v - at.yaw)};
  }

  double penalty_, flip_ = 1.0;
  bool mirrored_ = false;
  Word best_;
};

inline double positive(double angle) {  // in [0, 2 pi); values within rounding of a full turn become 0
  angle -= 2.0 * kPi * std::floor(angle / (2.0 * kPi));
  return angle > 2.0 * kPi - 1e-9 ? 0.0 : angle;
}

inline Word dubins(double x, double y, double phi) {
  const double d = std::hypot(x, y), theta = std::atan2(y, x), a = -theta, b = phi - theta;
  const double sa = std::sin(a), ca = std::cos(a), sb = std::sin(b), cb = std::cos(b), cross = ca * cb + sa * sb;
  Word best;
  const auto offer = [&](const char* steer, double t, double p, double q) {
    t = positive(t), q = positive(q);
    if (t + p + q < best.length) best = {{t, p, q}, steer, false, t + p + q, t + p + q};
  };
  const auto root = [](double square) { return std::sqrt(std::max(square, 0.0)); };
  double square = 2.0 + d * d - 2.0 * (cross - d * (sa - sb));
  if (square >= -1e-12) {
    const double turn = std::atan2(cb - ca, d + sa - sb);
    offer("LSL", turn - a, root(square), b - turn);
  }
  square = 2.0 + d * d - 2.0 * (cross - d * (sb - sa));
  if (square >= -1e-12) {
    const double turn = std::atan2(ca - cb, d - sa + sb);
    offer("RSR", a - turn, root(square), turn - b);
  }
  square = d * d - 2.0 + 2.0 * (cross - d * (sa + sb));
  if (square >= -1e-12) {
    const double p = root(square), turn = std::atan2(ca + cb, d - sa - sb) - std::atan2(2.0, p);
    offer("RSL", a - turn, p, b - turn);
  }
  square = d * d - 2.0 + 2.0 * (cross + d * (sa + sb));
  if (square >= -1e-12) {
    const double p = root(square), turn = std::atan2(-ca - cb, d + sa + sb) - std::atan2(-2.0, p);
    offer("LSR", turn - a, p, turn - b);
  }
  double share = 0.125 * (6.0 - d * d + 2.0 * (cross + d * (sa - sb)));
  if (std::abs(share) <= 1.0) {
    const double p = 2.0 * kPi - std::acos(share), t = positive(a - std::atan2(ca - cb, d - sa + sb) + 0.5 * p);
    offer("RLR", t, p, a - b - t + p);
  }
  share = 0.125 * (6.0 - d * d + 2.0 * (cross - d * (sa - sb)));
  if (std::abs(share) <= 1.0) {
    const double p = 2.0 * kPi - std::acos(share), t = positive(std::atan2(cb - ca, d + sa - sb) - a + 0.5 * p);
    offer("LRL", t, p, b - a - t + p);
  }
  return best;
}

}  // namespace words

// Steering limits and costs of a base. Cost: metres driven, those backwards times `penalty`, plus `yaw_length` per
// radian turned in place.
struct Steering {
  double radius = 1.0;            // least turning radius [m]
  bool reverse = true;            // whether it may drive backwards
  double yaw_length = kInfinity;  // [m/rad]; infinity: does not turn in place
  double penalty = 1.0;           // factor for driving backwards, at least 1

  double cost(const Piece& p) const {
    const double turned = p.turn == 0.0 ? 0.0 : yaw_length * std::abs(p.turn);
    return turned + (p.length < 0.0 ? -penalty * p.length : p.length);
  }
  // Length over which the impact is integrated [m].
  double measure(const Piece& p) const {
    return p.length != 0.0 ? std::abs(p.length) : p.turn == 0.0 ? 0.0 : yaw_length * std::abs(p.turn);
  }

  // The shortest curve of a car, or turn, straight, turn if that costs less.
  Curve shortest(const Pose& a, const Pose& b) const {
    const double dx = b.x - a.x, dy = b.y - a.y, c = std::cos(a.yaw), s = std::sin(a.yaw);
    const Pose to{(c * dx + s * dy) / radius, (c * dy - s * dx) / radius, wrapped(b.yaw - a.yaw)};
    Curve best = written(word_to(to, penalty));
    if (yaw_length < kInfinity) offer_turns(to, &best);
    return best;
  }
  // Lower bound on the cost of any curve, with or without turns in place and obstacles.
  double bound(const Pose& a, const Pose& b) const {
    const double straight = std::hypot(b.x - a.x, b.y - a.y), turned = std::abs(wrapped(b.yaw - a.yaw));
    const double simple = std::max(straight, std::min(yaw_length, radius) * turned);
    if (yaw_length < kInfinity) return simple;
    // Beyond some radii the heading hardly affects the cost. The bound approaches the simple one without a jump, so
    // that it never decreases by more than the cost of a move.
    const double most = 24.0 * radius - straight;
    if (most <= simple) return simple;
    const double dx = b.x - a.x, dy = b.y - a.y, c = std::cos(a.yaw), s = std::sin(a.yaw);
    const Pose to{(c * dx + s * dy) / radius, (c * dy - s * dx) / radius, wrapped(b.yaw - a.yaw)};
    return std::max(simple, std::min(most, radius * word_to(to, 1.0).length));
  }

 private:
  words::Word word_to(const Pose& to, double backwards) const {
    return reverse ? words::ReedsShepp(to.x, to.y, to.yaw, backwards).best() : words::dubins(to.x, to.y, to.yaw);
  }
  Curve written(const words::Word& word) const {
    Curve curve;
    curve.cost = 0.0;
    for (int i = 0; word.steer[i] != '\0'; ++i) {
      const double side = word.steer[i] == 'S' ? 0.0 : (word.steer[i] == 'L') != word.mirrored ? 1.0 : -1.0;
      const Piece piece{word.part[size_t(i)] * radius, side / radius, 0.0};
      if (piece.length == 0.0) continue;
      curve.pieces[size_t(curve.n++)] = piece;
      curve.cost += cost(piece);
    }
    return curve;
  }
  void offer_turns(const Pose& to, Curve* best) const {
    const double straight = radius * std::hypot(to.x, to.y), way = straight > 1e-12 ? std::atan2(to.y, to.x) : 0.0;
    for (int backwards = 0; backwards <= int(reverse); ++backwards) {
      const double first = straight > 1e-12 ? wrapped(way + backwards * kPi) : 0.0;
      const Piece turns[3] = {
          {0.0, 0.0, first}, {backwards ? -straight : straight, 0.0, 0.0}, {0.0, 0.0, wrapped(to.yaw - first)}};
      Curve curve;
      curve.cost = 0.0;
      for (const Piece& piece : turns) {
        if (piece.length == 0.0 && piece.turn == 0.0) continue;
        curve.pieces[size_t(curve.n++)] = piece;
        curve.cost += cost(piece);
      }
      if (curve.cost < best->cost) *best = curve;
    }
  }
};

}  // namespace gp::lattice
