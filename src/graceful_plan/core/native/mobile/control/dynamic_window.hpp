// The dynamic window approach of D. Fox, W. Burgard and S. Thrun (1997), with the impact of a base failure.
// control/dwa.py describes the method and its reasons.
#pragma once
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "mobile/coast/coasting.hpp"
#include "named.hpp"

namespace gp {

// Limits of a base, as in scene/mobile/diff_drive.py.
struct BaseLimits {
  double least, v, omega, a, alpha, lateral, lever, rim;
};

struct WindowSettings {
  double heading, velocity, path, clearance, impact;  // weights
  double horizon, period;                             // look-ahead, and command period [s]
  double near, margin, most;                          // sufficient and required clearance [m]; largest impact
  double ahead;                                       // from an arc's end to the point on the path to head for [m]
  double window;                                      // time of acceleration that bounds the candidate speeds [s]
  int n_v, n_omega;
};

template <class Visit> void fields(BaseLimits& of, Visit visit) {
  visit("least", of.least);
  visit("v", of.v);
  visit("omega", of.omega);
  visit("a", of.a);
  visit("alpha", of.alpha);
  visit("lateral", of.lateral);
  visit("lever", of.lever);
  visit("rim", of.rim);
}
template <class Visit> void fields(WindowSettings& of, Visit visit) {
  visit("heading", of.heading);
  visit("velocity", of.velocity);
  visit("path", of.path);
  visit("clearance", of.clearance);
  visit("impact", of.impact);
  visit("horizon", of.horizon);
  visit("period", of.period);
  visit("near", of.near);
  visit("margin", of.margin);
  visit("most", of.most);
  visit("ahead", of.ahead);
  visit("window", of.window);
}

// A polyline with the length up to each of its vertices.
class FloorPath {
 public:
  explicit FloorPath(const Reals& points) {
    require(points.ndim() == 2 && points.shape(1) == 2 && points.shape(0) > 0, "path");
    require_numbers(points, "path", kMaxExtent);
    for (size_t i = 0; i < points.shape(0); ++i) {
      const double x = points.data()[2 * i], y = points.data()[2 * i + 1];
      const double length = i ? s_.back() + std::hypot(x - x_.back(), y - y_.back()) : 0.0;
      x_.push_back(x), y_.push_back(y), s_.push_back(length);
    }
  }
  struct Foot {
    double s, distance;
  };
  double length() const { return s_.back(); }
  // The nearest point between two lengths.
  Foot nearest(double x, double y, double from, double to) const {
    Foot best{s_.back(), std::hypot(x - x_.back(), y - y_.back())};
    if (from > 0 || to < s_.back()) best.distance = std::numeric_limits<double>::infinity();
    for (size_t i = 1; i < x_.size(); ++i) {
      if (s_[i] < from || s_[i - 1] > to) continue;
      const double dx = x_[i] - x_[i - 1], dy = y_[i] - y_[i - 1], squared = dx * dx + dy * dy;
      const double t = squared > 0 ? std::clamp(((x - x_[i - 1]) * dx + (y - y_[i - 1]) * dy) / squared, 0.0, 1.0) : 0;
      const double d = std::hypot(x - x_[i - 1] - t * dx, y - y_[i - 1] - t * dy);
      if (d < best.distance) best = {s_[i - 1] + t * (s_[i] - s_[i - 1]), d};
    }
    return best;
  }
  std::array<double, 2> at(double s) const {
    if (s <= 0 || x_.size() == 1) return {x_.front(), y_.front()};
    if (s >= s_.back()) return {x_.back(), y_.back()};
    const size_t i = size_t(std::upper_bound(s_.begin(), s_.end(), s) - s_.begin());
    const double t = (s - s_[i - 1]) / (s_[i] - s_[i - 1]);
    return {x_[i - 1] + t * (x_[i] - x_[i - 1]), y_[i - 1] + t * (y_[i] - y_[i - 1])};
  }

 private:
  std::vector<double> x_, y_, s_;
};

class DynamicWindow {
 public:
  DynamicWindow(const CoastingArrays& of, const BaseLimits& limits, const WindowSettings& settings)
      : coasting_(of, gp::choose("auto").name), limits_(limits), set_(settings) {}

  struct Choice {
    double v = 0, omega = 0, score = 0, clearance = 0, impact = 0;
    bool admissible = false;
    int evaluated = 0;
  };
  struct Around {
    std::vector<FloorShape> shape;
    std::vector<double> severity;
  };

  // The best command. `every` evaluates all candidates, which takes longer and does not change the result.
  Choice choose(const Coasting::State& at, const FloorPath& path, const Around& around, bool every) const {
    Scene scene(*this, at, around);
    std::vector<Candidate> all = candidates(at, path);
    std::sort(all.begin(), all.end(), [](const Candidate& a, const Candidate& b) { return a.bound > b.bound; });
    std::optional<Choice> best, safest;
    int evaluated = 0;
    for (const Candidate& one : all) {
      if (!every && best && one.bound <= best->score) break;
      ++evaluated;
      const Seen seen = look(at, one, scene);
      if (!seen.admissible) continue;
      const double without = one.bound - set_.clearance * (1 - seen.room) - (1 - seen.reached);
      if (!every && best && without <= best->score) continue;
      const double impact = impact_of(at, one, scene);
      const Choice choice{one.v, one.omega, without - set_.impact * impact, seen.clearance, impact, true, 0};
      if (impact > set_.most) {
        if (!safest || impact < safest->impact) safest = choice;
      } else if (!best || choice.score > best->score) {
        best = choice;
      }
    }
    Choice out = best ? *best : safest ? *safest : braking(at, scene);
    out.evaluated = evaluated;
    // The command is limited to speeds that are reachable before the next command.
    const auto reached = [&](double now, double wanted, double rate) {
      return std::clamp(wanted, now - rate * set_.period, now + rate * set_.period);
    };
    const double rim = std::max(limits_.rim, std::fabs(at.v) + limits_.lever * std::fabs(at.omega));
    out.v = reached(at.v, out.v, limits_.a);
    const double across = std::max(limits_.lateral, std::fabs(at.v * at.omega));
    const double turns =
        std::min(std::max(0.0, rim - std::fabs(out.v)) / limits_.lever, across / std::max(std::fabs(out.v), 1e-9));
    out.omega = reached(at.omega, std::clamp(out.omega, -turns, turns), limits_.alpha);
    const double room = std::min(std::max(0.0, rim - limits_.lever * std::fabs(out.omega)),
                                 across / std::max(std::fabs(out.omega), 1e-9));
    out.v = std::clamp(out.v, -room, room);
    return out;
  }

 private:
  static constexpr int kSpeeds = 2, kRates = 3;  // nodes of the window at which failures are evaluated

  struct Candidate {
    double v, omega, bound;
  };
  struct Seen {
    bool admissible;
    double clearance, room, reached;  // least one [m]; its share of `near`; share of the horizon before a touch
  };
  // Shapes near enough to matter, and the current clearance of the base.
  struct Scene {
    Scene(const DynamicWindow& of, const Coasting::State& at, const Around& around)
        : all(around), work(of.coasting_.work(around.severity.size())), v(of.speeds(at)), omega(of.rates(at)) {
      impact.fill(-1);
      const double reach = of.coasting_.footprint().reach();
      const double far = (of.limits_.v + of.limits_.a * of.set_.period) * of.set_.horizon + reach + of.set_.near;
      for (const FloorShape& shape : around.shape) {
        const double moves = std::hypot(shape.vx, shape.vy);
        const double d = shape.distance(at.x, at.y, 0.0);
        if (d < far + moves * of.set_.horizon) near.push_back(shape), fastest = std::max(fastest, moves);
      }
      now = of.clearance(near, at.x, at.y, at.yaw, 0, of.set_.near);
    }
    const Around& all;
    Coasting::Work work;
    const std::array<double, 2> v, omega;  // speeds in the window
    std::array<double, kSpeeds * kRates> impact;
    std::vector<FloorShape> near;
    double fastest = 0, now = 0;
  };

  static Coasting::State moved(const Coasting::State& at, double v, double omega, double time) {
    const double half = 0.5 * omega * time;
    const double chord = v * time * (std::fabs(half) > 1e-9 ? std::sin(half) / half : 1.0);
    return {at.x + chord * std::cos(at.yaw + half), at.y + chord * std::sin(at.yaw + half), at.yaw + 2 * half, v,
            omega};
  }
  double clearance(const std::vector<FloorShape>& shapes, double x, double y, double yaw, double time,
                   double most) const {
    const Footprint2d& base = coasting_.footprint();
    const double c = std::cos(yaw), s = std::sin(yaw);
    double least = most;
    for (const FloorShape& shape : shapes)
      if (shape.distance(x, y, time) - base.reach() < least)
        least = std::min(least, base.distance(shape, x, y, c, s, time));
    return least;
  }

  std::array<double, 2> window(double now, double rate, double low, double high) const {
    return {std::clamp(now - rate * set_.window, low, high), std::clamp(now + rate * set_.window, low, high)};
  }
  std::array<double, 2> speeds(const Coasting::State& at) const {
    return window(at.v, limits_.a, limits_.least, limits_.v);
  }
  std::array<double, 2> rates(const Coasting::State& at) const {
    return window(at.omega, limits_.alpha, -limits_.omega, limits_.omega);
  }
  // Candidates in the window, with an upper bound of the score that needs no look at the surroundings.
  std::vector<Candidate> candidates(const Coasting::State& at, const FloorPath& path) const {
    const auto v = speeds(at), w = rates(at);
    const FloorPath::Foot foot = path.nearest(at.x, at.y, 0, path.length());
    std::vector<Candidate> all;
    for (int i = 0; i < set_.n_v; ++i) {
      const double speed = v[0] + (v[1] - v[0]) * i / std::max(set_.n_v - 1, 1);
      for (int j = 0; j < set_.n_omega; ++j)
        consider(at, path, foot, speed, w[0] + (w[1] - w[0]) * j / std::max(set_.n_omega - 1, 1), all);
      // Straight ahead, and the arc to the path ahead, in addition to the grid.
      if (w[0] < 0 && w[1] > 0) consider(at, path, foot, speed, 0, all);
      const auto carrot = path.at(foot.s + set_.ahead + std::fabs(speed) * set_.horizon);
      const double dx = carrot[0] - at.x, dy = carrot[1] - at.y, squared = dx * dx + dy * dy;
      const double across = -std::sin(at.yaw) * dx + std::cos(at.yaw) * dy;
      if (squared > 1e-6) consider(at, path, foot, speed, std::clamp(2 * speed * across / squared, w[0], w[1]), all);
    }
    return all;
  }
  void consider(const Coasting::State& at, const FloorPath& path, const FloorPath::Foot& foot, double v, double omega,
                std::vector<Candidate>& all) const {
    const bool turns_as_hard = std::fabs(v * omega) <= std::max(limits_.lateral, 0.98 * std::fabs(at.v * at.omega));
    if (!turns_as_hard || std::fabs(v) + limits_.lever * std::fabs(omega) > limits_.rim * (1 + 1e-9)) return;
    const double left = path.length() - foot.s;
    // Candidates that do not brake must be able to stop at the end of the path with half of the deceleration limit.
    const double room = std::max(left - std::fabs(v) * set_.period, 0.0);
    if (v > std::max(std::sqrt(limits_.a * room), kCreep) && v > at.v - 0.999 * limits_.a * set_.window) return;
    // Progress is relative to the fastest reachable speed, so a standing base is drawn forward like a moving one. Near
    // the end, the time is that of the fastest candidate to the end.
    const double reached = std::min(limits_.v, std::fabs(at.v) + limits_.a * set_.window);
    const double time = std::clamp(left / reached, 2 * set_.period, std::max(set_.horizon, 2 * set_.period));
    double progress = 0, off = 0, heading = 0;
    for (const double part : {0.5, 1.0}) {
      const Coasting::State end = moved(at, v, omega, part * time);
      const FloorPath::Foot place =
          path.nearest(end.x, end.y, foot.s - kBack, foot.s + limits_.v * set_.horizon + kBack);
      const auto carrot = path.at(place.s + set_.ahead);
      const double wanted = std::atan2(carrot[1] - end.y, carrot[0] - end.x) - end.yaw;
      progress += 0.5 * std::clamp((place.s - foot.s) / (part * reached * time), -1.0, 1.0);
      off += 0.5 * std::min(place.distance, kBack);
      heading += 0.5 * (1 - std::fabs(std::remainder(wanted, kTurn)) / (0.5 * kTurn));
    }
    // At the end of the path the position counts, not the heading.
    const double bound = set_.heading * heading * std::min(1.0, left / std::max(set_.ahead, 1e-3)) +
                         set_.velocity * progress - set_.path * off + set_.clearance;
    all.push_back({v, omega, bound});
  }

  // Follows the arc in steps that are short enough to miss no contact.
  Seen look(const Coasting::State& at, const Candidate& one, const Scene& scene) const {
    const double reach = coasting_.footprint().reach();
    const double fastest = std::fabs(one.v) + std::fabs(one.omega) * reach + scene.fastest;
    const double touch = std::min(set_.margin, scene.now - kCloser);
    // Slow candidates are followed as far as the fastest, so that they see obstacles ahead, but at most for a quarter
    // turn.
    const double far = std::min(limits_.v, std::fabs(at.v) + limits_.a * set_.window) * set_.horizon;
    const double once = std::fabs(one.omega) > 0 ? 0.25 * kTurn / std::fabs(one.omega) : 1e9;
    const double slow = std::min({far / std::max(std::fabs(one.v), 1e-6), once, kLonger * set_.horizon});
    const double horizon = std::max(set_.horizon, slow);
    double least = scene.now, time = std::min(kStep, horizon);
    for (;;) {
      const Coasting::State p = moved(at, one.v, one.omega, time);
      const double d = clearance(scene.near, p.x, p.y, p.yaw, time, set_.near);
      least = std::min(least, d);
      if (d <= touch) break;
      if (time >= horizon) return {true, least, std::max(least, 0.0) / set_.near, 1};
      time = std::min(horizon, time + std::max(kStep, fastest > 0 ? (d - set_.near) / fastest : horizon));
    }
    // The base must stop before the touch; it keeps its speed until the next command.
    const double left = std::max(0.0, time - kStep - set_.period);
    const bool stops = std::fabs(one.v) <= 2 * limits_.a * left && std::fabs(one.omega) <= 2 * limits_.alpha * left;
    return {stops, least, 0, time / horizon};
  }
  // Mean impact of failures at the next command and half a horizon later, interpolated between few speeds and rates
  // because it varies little within the window.
  double impact_of(const Coasting::State& at, const Candidate& one, Scene& scene) const {
    if (scene.all.severity.empty()) return 0;
    const auto place = [](const std::array<double, 2>& window, double value, int nodes) {
      const double span = std::max(window[1] - window[0], 1e-12), part = (value - window[0]) / span * (nodes - 1);
      const int low = std::clamp(int(part), 0, nodes - 2);
      return std::pair<int, double>{low, std::clamp(part - low, 0.0, 1.0)};
    };
    const auto [i, p] = place(scene.v, one.v, kSpeeds);
    const auto [j, r] = place(scene.omega, one.omega, kRates);
    double sum = 0;
    for (int a = 0; a < 2; ++a) {
      for (int b = 0; b < 2; ++b) {
        const double weight = (a ? p : 1 - p) * (b ? r : 1 - r);
        if (weight > 0) sum += weight * impact_at(at, i + a, j + b, scene);
      }
    }
    return sum;
  }
  double impact_at(const Coasting::State& at, int i, int j, Scene& scene) const {
    double& known = scene.impact[size_t(i * kRates + j)];
    if (known >= 0) return known;
    known = 0;
    const double v = scene.v[0] + (scene.v[1] - scene.v[0]) * i / (kSpeeds - 1);
    const double omega = scene.omega[0] + (scene.omega[1] - scene.omega[0]) * j / (kRates - 1);
    for (const double time : {set_.period, 0.5 * set_.horizon}) {
      if (!coasting_.hits(moved(at, v, omega, time), scene.all.shape, {scene.all.severity.data()}, scene.work))
        continue;
      for (size_t e = 0; e < scene.all.severity.size(); ++e) known += 0.5 * scene.all.severity[e] * scene.work.hit[e];
    }
    return known;
  }
  // Braking at the limits, along the current arc.
  Choice braking(const Coasting::State& at, const Scene& scene) const {
    const double left = std::max(0.0, 1 - limits_.a * set_.period / std::max(std::fabs(at.v), 1e-9));
    const double turns = std::max(0.0, 1 - limits_.alpha * set_.period / std::max(std::fabs(at.omega), 1e-9));
    const double omega = at.omega * (std::fabs(at.v) > 1e-3 ? std::max(left, turns) : turns);
    return {at.v * left, omega, 0, scene.now, 0, false, 0};
  }

  static constexpr double kStep = 0.04;    // least step along an arc [s]
  static constexpr double kCloser = 2e-3;  // amount by which a base closer than the margin may come closer still [m]
  static constexpr double kLonger = 3;     // limit on the duration of slow candidates, in horizons
  static constexpr double kCreep = 0.02;   // speed at or below which any distance is enough to stop [m/s]
  static constexpr double kBack = 0.5;     // length of the path that is searched behind and beyond [m]
  static constexpr double kTurn = 6.283185307179586;

  const Coasting coasting_;
  const BaseLimits limits_;
  const WindowSettings set_;
};

}  // namespace gp
