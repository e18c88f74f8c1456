// The search of the default planner. RRT-Connect finds the first path; then candidates (challengers) compete with the
// best path one after the other. Candidates come from small roadmaps (Scout), detours of the best path, RRT-Connect
// restricted to low impact, and cost-bounded RRT-Connect (AO-x, which only returns better paths). Each candidate
// descends along the gradient of J and is refined by random moves while it may still win. A new best path is polished:
// a last descent on more vertices. If J has no gradient, several candidates are refined in parallel instead.
#pragma once
#include <algorithm>
#include <memory>

#include "search/challenger.hpp"
#include "search/connect.hpp"
#include "search/scout.hpp"

namespace gp {

struct AnytimeSettings {
  ConnectSettings connect;
  double spacing = 0.2;
  int challengers = 8;  // candidates in a contest, without gradient
  bool descents = true, scouts = true;
};

class Anytime {
 public:
  Anytime(Space& space, Point start, std::vector<Point> goals, AnytimeSettings settings, uint64_t seed)
      : space_(space),
        start_(start),
        goals_(goals),
        settings_(settings),
        descends_(settings.descents && space.has_slopes() && space.w > 0),
        random_(seed),
        connect_(space, start, goals, settings.connect, random_.bits()),
        scout_(space, std::move(start), std::move(goals), random_.bits()) {}

  // Works until the slice ends; returns true if the best path changed. Stops early at a proven optimum.
  bool run(Slice& slice) {
    const bool first = best_.q.empty();  // the first path is reported at once, not at the end of the slice
    bool improved = false;
    while (!optimal() && !(first && improved) && slice.next()) improved |= step();
    return improved;
  }
  const Polyline& best() const { return best_; }

  // A straight path at w = 0 is optimal.
  bool optimal() const {
    if (best_.q.empty() || !space_.motion_is_length()) return false;
    double bound = std::numeric_limits<double>::infinity();
    for (const Point& goal : goals_) bound = std::min(bound, space_.distance(start_.data(), goal.data()));
    return best_.total <= bound * (1 + 1e-9);
  }

  // Continues from a given collision-free path if it is better than the best path.
  void adopt(std::vector<Point> path) { take(Polyline::of(space_, std::move(path))); }

  // Considers a path next. Without a gradient, it must be collision-free.
  void suggest(std::vector<Point> path) {
    const bool free = space_.path_free(path);
    if (descends_ || free)
      challengers_.insert(challengers_.begin(), challenger(std::move(path), free ? kPolish : kSuggested));
  }

 private:
  enum Source {
    kScoutLine,
    kScoutBest,
    kDetour,
    kToolDetour,
    kValley,
    kPlain,
    kBound,
    kPolish,
    kSources,
    kSuggested = kSources
  };
  static constexpr int64_t kFirstRound = 150, kLastRound = 5000;  // moves of each candidate in a contest
  static constexpr int kFirstScout = 150, kLastScout = 600;       // nodes of a roadmap
  static constexpr size_t kElite = 6;                             // best paths kept

  bool step() {
    ++steps_;
    if (best_.q.empty()) return connect_.step() && offer(connect_.path(), kPlain);
    const bool settled = incumbent_->settled() < 0.02;
    if (steps_ % (descends_ ? 64 : settled ? 16 : 2) == 0) return incumbent_->step() && take(incumbent_->path());
    return descends_ ? chase() : contest();
  }

  // One candidate at a time: descends it, and drops candidates that will not beat the best path.
  bool chase() {
    if (challengers_.empty()) return explore();
    Challenger& one = *challengers_.front();
    one.step();
    bool improved = false;
    if (std::vector<Point> early = one.take_early(); !early.empty())
      improved = take(Polyline::of(space_, std::move(early)));
    if (one.refiner()) improved |= take(one.refiner()->path());
    if (improved) ++won_;
    if (one.hopeless(best_.total)) {
      if (one.refiner()) remember(one.refiner()->path());
      unpolished_ |= won_ > 0 && one.source() != kPolish;
      reward(one.source(), won_ > 0);
      won_ = 0;
      challengers_.erase(challengers_.begin());
    }
    return improved;
  }

  // Successive halving: collects candidates, refines each a little, drops the worse half, refines the rest twice as
  // long, and so on. The last one is refined until it wins or settles.
  bool contest() {
    if (turns_ == 0) {
      if (int(challengers_.size()) < settings_.challengers) return explore();
      turns_ = kFirstRound, turn_ = 0;
    }
    if (challengers_.empty()) return end_contest();
    std::unique_ptr<Challenger>& one = challengers_[size_t(turn_++) % challengers_.size()];
    one->step();
    if (one->estimate() < best_.total) {
      reward(one->source(), true);
      std::swap(incumbent_, one->refiner());
      best_ = incumbent_->path();
      return true;
    }
    if (turn_ < turns_ * int64_t(challengers_.size())) return false;
    turn_ = 0, turns_ *= 2;
    if (challengers_.size() == 1) {
      const Challenger& last = *challengers_[0];
      return (last.settled() < 0.02 || last.estimate() > 1.1 * best_.total || turns_ > kLastRound) && end_contest();
    }
    std::stable_sort(challengers_.begin(), challengers_.end(),
                     [](const auto& a, const auto& b) { return a->estimate() < b->estimate(); });
    challengers_.resize((challengers_.size() + 1) / 2);
    return false;
  }
  bool end_contest() {
    challengers_.clear();
    turns_ = 0;
    return false;
  }

  // Prefers sources that improved the best path recently.
  void reward(int source, bool won) {
    if (source < kSources) score_[source] = won ? 0.9 * score_[source] + 1.0 : 0.95 * score_[source];
  }
  Source choose() {
    // Initial frequency of each source.
    const bool feared = space_.w > 0, scouts = descends_ && settings_.scouts;
    const double prior[kSources] = {scouts ? 1.0 : 0.0,   scouts ? 1.5 : 0.0, 1.0, 1.0, feared ? 0.8 : 0.0, 0.2, 0.3,
                                    descends_ ? 3.0 : 0.0};
    double weight[kSources], sum = 0;
    for (int s = 0; s < kSources; ++s) sum += weight[s] = prior[s] * (0.3 + score_[s]);
    double u = random_.uniform() * sum;
    for (int s = 0; s < kSources; ++s)
      if ((u -= weight[s]) < 0) return Source(s);
    return kDetour;
  }

  // Looks for another path. Searches continue across steps until they succeed or run for too long.
  bool explore() {
    if (scouting_) {
      if (scout_.step()) offer(scout_.path(), source_);
      scouting_ = !scout_.done();
      return false;
    }
    if (searching_) {
      searching_ = ++search_age_ < 300;
      if (!connect_.step()) return false;
      searching_ = false;
      return offer(connect_.path(), source_);
    }
    source_ = unpolished_ ? kPolish : scouts_ == 0 && descends_ && settings_.scouts ? kScoutLine : choose();
    unpolished_ = false;
    if (source_ == kPolish) return offer(best_.q, kPolish);
    if (source_ == kDetour) return detour();
    if (source_ == kToolDetour) return tool_detour();
    if (source_ == kScoutLine || source_ == kScoutBest) return scout();
    const double infinite = std::numeric_limits<double>::infinity();
    connect_.reset(source_ == kBound ? best_.total : infinite,
                   source_ == kValley ? mean_impact() * random_.uniform(0.05, 1.5) : infinite);
    connect_.skip_direct();
    searching_ = true;
    search_age_ = 0;
    return false;
  }

  // Starts a roadmap around the straight line or the best path. Each is larger than the last and contains the best
  // paths.
  bool scout() {
    const bool line = source_ == kScoutLine;
    const Point& goal = goals_[size_t(random_.below(int(goals_.size())))];
    std::vector<std::vector<Point>> known;
    if (scouts_ > 0) known.push_back(best_.q);
    for (const Polyline& path : elite_) known.push_back(path.q);
    scout_.begin(line ? std::vector<Point>{start_, goal} : best_.q, known, line ? 0.5 : 0.25,
                 std::min(kLastScout, kFirstScout << std::min(scouts_, 4)));
    ++scouts_;
    scouting_ = true;
    return false;
  }

  double mean_impact() const {
    double length = 0, exposure = 0;
    for (size_t i = 0; i + 1 < best_.q.size(); ++i) {
      const double *a = best_.q[i].data(), *b = best_.q[i + 1].data();
      length += space_.distance(a, b), exposure += space_.exposure(a, b);
    }
    return std::max(0.0, best_.total - length) / (space_.w * std::max(exposure, 1e-9));
  }

  // Routes the straight path, or a section of the best path, through the most promising of several random via points.
  bool detour() {
    const std::vector<Point>& q = best_.q;
    size_t i = 0, j = q.size() - 1;
    if (random_.uniform() < 0.5 && q.size() > 3) {
      i = size_t(random_.below(int(q.size()))), j = size_t(random_.below(int(q.size())));
      if (i > j) std::swap(i, j);
      if (j - i < 2) return false;
    }
    std::vector<Point> points(q.begin(), q.begin() + long(i) + 1);
    points.push_back(via_point(q[i], q[j]));
    points.insert(points.end(), q.begin() + long(j), q.end());
    return (descends_ || space_.path_free(points, i, i + 2)) && offer(std::move(points), kDetour);
  }

  // Moves the tool higher, lower or aside along a section of the best path, by steps along its Jacobian.
  bool tool_detour() {
    const int n = int(best_.q.size());
    if (n < 3) return detour();
    int i = random_.below(n), j = random_.below(n);
    if (random_.uniform() < 0.5) i = 0, j = n - 1;
    if (i > j) std::swap(i, j);
    if (j - i < 2) return false;
    const double size = 0.3 * random_.uniform();
    const double aside[3] = {random_.normal() * size, random_.normal() * size, random_.normal() * size};
    std::vector<Point> points = best_.q;
    for (int k = i + 1; k < j; ++k) {
      const double s = 2.0 * (k - i) / (j - i) - 1.0, bump = std::min(1.0, 1.6 * (1.0 - s * s));
      Point& q = points[size_t(k)];
      Point d(q.size());
      constexpr int kSteps = 6;  // linearised steps of a move of the tool
      const double step[3] = {aside[0] * bump / kSteps, aside[1] * bump / kSteps, aside[2] * bump / kSteps};
      for (int count = 0; count < kSteps; ++count) {
        if (!space_.move_tool(q.data(), step, d.data())) return false;
        for (size_t c = 0; c < q.size(); ++c) q[c] = std::clamp(q[c] + d[c], space_.lower[c], space_.upper[c]);
      }
    }
    return (descends_ || space_.path_free(points, size_t(i), size_t(j))) && offer(std::move(points), kToolDetour);
  }

  Point via_point(const Point& a, const Point& b) {
    constexpr int kTried = 16;  // samples compared by their impact; the best one is kept
    const size_t dim = a.size();
    std::vector<double> points(kTried * dim);
    const int tried = space_.w > 0 ? kTried : 1;
    for (int k = 0; k < tried; ++k) {
      const double s = random_.uniform(), radius = 0.3 * space_.extent() * std::pow(random_.uniform(), 2.0);
      for (size_t d = 0; d < dim; ++d) {
        const double value = a[d] + s * (b[d] - a[d]) + radius * random_.normal() / std::sqrt(double(dim));
        points[size_t(k) * dim + d] = std::clamp(value, space_.lower[d], space_.upper[d]);
      }
    }
    double impact[kTried] = {}, least = std::numeric_limits<double>::infinity();
    if (tried > 1) space_.impacts(points.data(), tried, impact);
    const double* best = points.data();
    for (int k = 0; k < tried; ++k) {
      const double* via = points.data() + size_t(k) * dim;
      const double guess = space_.guess(a.data(), via, impact[k]) + space_.guess(via, b.data(), impact[k]);
      if (guess < least) least = guess, best = via;
    }
    return Point(best, best + dim);
  }

  // Adds a candidate. It becomes the best path at once if it is the first free path, or if nothing descends and it is
  // better.
  bool offer(std::vector<Point> path, Source source) {
    if (space_.w == 0) cut_short(path);
    if (best_.q.empty()) {
      take(Polyline::of(space_, path));
      if (!descends_) challengers_.push_back(challenger(std::move(path), source));
      return true;
    }
    challengers_.push_back(challenger(std::move(path), source));
    if (descends_ || challengers_.back()->estimate() >= best_.total) return false;
    std::swap(incumbent_, challengers_.back()->refiner());
    best_ = incumbent_->path();
    return true;
  }
  std::unique_ptr<Challenger> challenger(std::vector<Point> path, Source source) {
    const auto beginning = !descends_ ? Beginning::kMove : source == kPolish ? Beginning::kPolish : Beginning::kCoarse;
    const ChallengerSettings settings{settings_.spacing, beginning, scouts_ > 1, source};
    return std::make_unique<Challenger>(space_, std::move(path), settings, random_.bits());
  }

  // Drops vertices where the straight edge is free, longest edges first; if the cost is length, the path gets shorter.
  void cut_short(std::vector<Point>& path) {
    for (size_t i = 0; i + 2 < path.size(); ++i)
      for (size_t j = path.size() - 1; j > i + 1; --j)
        if (space_.edge_free(path[i].data(), path[j].data()) && space_.edge_certain(path[i].data(), path[j].data())) {
          path.erase(path.begin() + long(i) + 1, path.begin() + long(j));
          break;
        }
  }

  bool take(const Polyline& path) {
    if (path.total >= best_.total) return false;
    if (!incumbent_ || &path != &incumbent_->path())
      incumbent_ = std::make_unique<Refiner>(space_, path, settings_.spacing, random_.bits());
    best_ = path;
    return true;
  }

  // Keeps a few good paths for roadmaps, which may combine parts of them.
  void remember(const Polyline& path) {
    if (path.total > 1.5 * best_.total) return;
    elite_.push_back(path);
    std::stable_sort(elite_.begin(), elite_.end(),
                     [](const Polyline& a, const Polyline& b) { return a.total < b.total; });
    if (elite_.size() > kElite) elite_.pop_back();
  }

  Space& space_;
  Point start_;
  std::vector<Point> goals_;
  AnytimeSettings settings_;
  const bool descends_;
  Random random_;
  Connect connect_;
  Scout scout_;
  Polyline best_;
  std::unique_ptr<Refiner> incumbent_;
  std::vector<std::unique_ptr<Challenger>> challengers_;
  std::vector<Polyline> elite_;
  double score_[kSources] = {1, 1, 1, 1, 1, 1, 1, 1};
  Source source_ = kPlain;
  int64_t steps_ = 0, turn_ = 0, turns_ = 0;
  bool scouting_ = false, searching_ = false, unpolished_ = false;
  int scouts_ = 0, search_age_ = 0, won_ = 0;
};

}  // namespace gp
