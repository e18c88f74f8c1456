// A candidate path: it descends on few vertices, then on more, and is then refined by random moves.
#pragma once
#include <memory>
#include <utility>

#include "search/descent.hpp"
#include "search/refine.hpp"

namespace gp {

// First stage of a candidate: random moves of a free path, a coarse descent, or a final descent on many vertices.
enum class Beginning { kMove, kCoarse, kPolish };

struct ChallengerSettings {
  double spacing;
  Beginning beginning;
  bool patient;  // descends further before the refiner takes over
  int source;    // of the path
};

class Challenger {
 public:
  Challenger(Space& space, std::vector<Point> path, const ChallengerSettings& settings, uint64_t seed)
      : space_(space), settings_(settings), seed_(seed) {
    if (settings.beginning == Beginning::kMove)
      refine(std::move(path));
    else if (settings.beginning == Beginning::kCoarse)
      descent_ =
          std::make_unique<Descent>(space, path, kPieces, DescentSettings{.step = kStep, .push = 5.0, .rough = true});
    else
      polish(path);
  }

  int source() const { return settings_.source; }
  // J of the path, or the estimate of the descent.
  double estimate() const {
    return failed_ ? std::numeric_limits<double>::infinity() : descent_ ? descent_->value() : refiner_->path().total;
  }
  double settled() const { return refiner_ ? refiner_->settled() : 1.0; }
  // Null during the descent.
  std::unique_ptr<Refiner>& refiner() { return refiner_; }

  // One evaluation of a descent, or one move of a refiner.
  void step() {
    if (failed_) return;
    ++used_;
    if (refiner_) {
      refiner_->step();
      return;
    }
    if (descent_->step() && used_ < limit_) return;
    if (fine_) return land();
    if (std::vector<Point> path = descent_->path(); space_.path_free(path)) early_ = std::move(path);
    sharpen();
  }
  // The result of the coarse descent, if it is free; returned once, then empty.
  std::vector<Point> take_early() { return std::exchange(early_, {}); }

  // Whether the candidate is unlikely to beat a path with cost `best`.
  bool hopeless(double best) const {
    const double e = estimate();
    if (failed_) return true;
    if (refiner_) return used_ >= kMoves;
    return fine_ ? used_ >= 30 && e > 1.2 * best : used_ >= 15 && e > 2.0 * best;
  }

 private:
  // Pieces of the path in the coarse, the fine and the last descent.
  static constexpr int kPieces = 14, kFinePieces = 40, kLastPieces = 100;
  static constexpr double kStep = 0.15, kFineStep = 0.05, kLastStep = 0.04;  // distance between samples of the impact
                                                                             // [rad]
  // Evaluations in the coarse, fine and final descent, and after each hardening; moves of the refiner.
  // Steps of each descent and after a hardening; random moves of a refinement.
  static constexpr int kSteps = 30, kFineSteps = 50, kLastSteps = 200, kMoreSteps = 30, kMoves = 30;
  static constexpr int kHardenings = 2;  // then the candidate is dropped

  // Moves from the coarse to the fine descent.
  void sharpen() {
    descent_ =
        std::make_unique<Descent>(space_, descent_->path(), kFinePieces,
                                  DescentSettings{.step = kFineStep, .tolerance = settings_.patient ? 1e-4 : 1e-3});
    fine_ = true, used_ = 0, limit_ = settings_.patient ? 2 * kFineSteps : kFineSteps;
  }
  // Number of vertices and step are randomised, since the local minimum depends on them.
  void polish(const std::vector<Point>& path) {
    Random random(seed_);
    const int pieces = int(kLastPieces * random.uniform(0.75, 1.35));
    descent_ = std::make_unique<Descent>(
        space_, path, pieces, DescentSettings{.step = kLastStep * random.uniform(0.75, 1.35), .tolerance = 1e-4});
    fine_ = true, limit_ = kLastSteps;
  }
  void land() {
    std::vector<Point> path = descent_->path();
    if (space_.path_free(path)) {
      descent_.reset();
      return refine(std::move(path));
    }
    failed_ = hardened_ == kHardenings;
    if (failed_) return;
    ++hardened_;
    descent_->harden();
    used_ = 0, limit_ = kMoreSteps;
  }
  void refine(std::vector<Point> path) {
    used_ = 0;
    refiner_ = std::make_unique<Refiner>(space_, Polyline::of(space_, std::move(path)), settings_.spacing, seed_);
  }

  Space& space_;
  ChallengerSettings settings_;
  uint64_t seed_;
  std::vector<Point> early_;
  std::unique_ptr<Descent> descent_;
  std::unique_ptr<Refiner> refiner_;
  bool fine_ = false, failed_ = false;
  int used_ = 0, limit_ = kSteps, hardened_ = 0;
};

}  // namespace gp
