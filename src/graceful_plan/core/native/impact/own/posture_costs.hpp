// Costs of postures and of tool poses.
#pragma once
#include <algorithm>

#include "impact/own/state_cost.hpp"

namespace gp {

// Mean over joints of ((q - centre) / scale)^2.
class JointCost final : public StateCost {
 public:
  JointCost(const Core& core, const Reals& centre, const Reals& scale)
      : StateCost(core), centre_(point(centre)), scale_(point(scale)) {
    require_numbers(centre, joints(), "centre of each joint");
    require_positive(scale, joints(), "scale of each joint");
  }

 protected:
  void charge(const double* q, size_t n, double* value, double* slope) const override {
    const size_t nq = joints();
    for (size_t k = 0; k < n; ++k) {
      value[k] = 0;
      for (size_t j = 0; j < nq; ++j) {
        const double off = (q[k * nq + j] - centre_[j]) / scale_[j];
        value[k] += off * off / double(nq);
        if (slope) slope[k * nq + j] = 2 * off / (scale_[j] * double(nq));
      }
    }
  }

 private:
  const Point centre_, scale_;
};

// Mean over joints of (torque / limit)^2, with the torques that hold the arm and its load against gravity.
class EnergyCost final : public StateCost {
 public:
  // `inertia`: per frame mass, centre (3), inertia about it (9), as in the body model.
  EnergyCost(const Core& core, const Reals& inertia, const Reals& limit) : StateCost(core), limit_(point(limit)) {
    const Tables& t = core.tables();
    require_positive(limit, joints(), "limits of joints");
    require_numbers(inertia, 13 * (joints() + 1), "inertia of frames");
    for (size_t f = 0; f <= joints(); ++f) {
      const double* row = inertia.data() + 13 * f;
      Inertia rigid{};
      rigid.mass = row[0];
      std::copy(row + 1, row + 4, rigid.centre), std::copy(row + 4, row + 13, rigid.inertia);
      require(core.frame(int(f)) == int(f), "links that own a frame are not first");
      inertia_.push_back(rigid);
    }
    drive_.resize(joints());
    for (int l = 0; l < t.n_link; ++l)
      if (t.link[l].joint >= 0) drive_[size_t(t.link[l].joint)].link = l;
    tables_.n_frame = int(inertia_.size()), tables_.inertia = inertia_.data(), tables_.drive = drive_.data();
  }

 protected:
  void charge(const double* q, size_t n, double* value, double* slope) const override {
    const size_t nq = joints(), size = n * nq, copies = slope ? nq + 1 : 1;
    Point moved, gravity(copies * size), mass(copies * size * nq);
    for (size_t c = 0; c < copies; ++c) {
      moved.insert(moved.end(), q, q + size);
      for (size_t k = 0; c > 0 && k < n; ++k) moved[c * size + k * nq + c - 1] += kStep;
    }
    core_.kernels().body_dynamics(core_.tables(), tables_, {moved.data(), nullptr, copies * n}, mass.data(),
                                  gravity.data());
    for (size_t k = 0; k < n; ++k) {
      value[k] = deviation_cost(&gravity[k * nq]);
      for (size_t j = 0; slope && j < nq; ++j)
        slope[k * nq + j] = (deviation_cost(&gravity[(j + 1) * size + k * nq]) - value[k]) / kStep;
    }
  }

 private:
  static constexpr double kStep = 1e-6;  // step of finite differences, in double precision [rad]

  double deviation_cost(const double* torque) const {
    double sum = 0;
    for (size_t j = 0; j < limit_.size(); ++j) sum += torque[j] * torque[j] / (limit_[j] * limit_[j]);
    return sum / double(limit_.size());
  }

  const Point limit_;
  std::vector<Inertia> inertia_;
  std::vector<JointDrive> drive_;
  BodyTables tables_{};
};

// Distance of the tool from a pose: (distance / unit)^2 for its position, and 2 (1 - cos angle) / unit^2 for its
// orientation, which is the squared angle where small. An infinite unit disables its part.
class PoseCost final : public StateCost {
 public:
  // The position of the tool in its link, and the wanted position in W. For a link rotated by R, trace(R^T turn) is
  // `full` at the wanted orientation, and smaller by 2 (1 - cos angle) elsewhere.
  struct Wanted {
    int link;
    Reals tool, position, turn;
    double full;
  };

  PoseCost(const Core& core, const Wanted& wanted, double distance, double angle)
      : StateCost(core),
        link_(wanted.link),
        tool_(point(wanted.tool)),
        position_(point(wanted.position)),
        turn_(point(wanted.turn)),
        full_(wanted.full),
        per_distance_(1 / (distance * distance)),
        per_angle_(1 / (angle * angle)) {
    require(link_ >= 0 && link_ < core.tables().n_link, "link");
    require_numbers(wanted.tool, 3, "tool", kMaxExtent), require_numbers(wanted.position, 3, "position", kMaxExtent);
    require_numbers(wanted.turn, 9, "turn"), require(in_range(full_, -kMaxNumber), "turn");
    require(distance >= 1 / kMaxNumber && angle >= 1 / kMaxNumber, "units");
  }

 protected:
  void charge(const double* q, size_t n, double* value, double* slope) const override {
    const size_t nq = joints();
    std::vector<Ride> ride(n);
    core_.ride(q, n, link_, tool_.data(), ride.data());
    for (size_t k = 0; k < n; ++k) {
      const Ride& at = ride[k];
      double off[3], about[3] = {0, 0, 0}, squared = 0, trace = 0;
      for (size_t i = 0; i < 3; ++i) off[i] = at.p[i] - position_[i], squared += off[i] * off[i];
      for (size_t i = 0; i < 9; ++i) trace += at.R[i] * turn_[i];
      for (size_t c = 0; c < 3; ++c)
        for (size_t i = 0; i < 3; ++i) {
          const size_t a = 3 * ((i + 1) % 3) + c, b = 3 * ((i + 2) % 3) + c;
          about[i] += at.R[a] * turn_[b] - at.R[b] * turn_[a];
        }
      value[k] = per_distance_ * squared + per_angle_ * std::max(0.0, full_ - trace);
      for (size_t j = 0; slope && j < nq; ++j) {
        double d = 0;
        for (size_t i = 0; i < 3; ++i)
          d += 2 * per_distance_ * off[i] * at.J[i * nq + j] - per_angle_ * about[i] * at.turn[i * nq + j];
        slope[k * nq + j] = d;
      }
    }
  }

 private:
  const int link_;
  const Point tool_, position_, turn_;
  const double full_, per_distance_, per_angle_;
};

// (1 - w / least)^2 where w < least, with Yoshikawa's manipulability w = sqrt(det J J^T) of the tool; J is the Jacobian
// of its position and rotation [m and rad per rad].
//
// References:
//   T. Yoshikawa, "Manipulability of robotic mechanisms", IJRR 1985.
class ManipulabilityCost final : public StateCost {
 public:
  // `chain`: the joints from the base to the tool, in this order.
  ManipulabilityCost(const Core& core, int link, Reals tool, const Integers& chain, double least)
      : StateCost(core), link_(link), tool_(point(tool)), least_(least) {
    require(link >= 0 && link < core.tables().n_link, "tool");
    require_numbers(tool, 3, "tool", kMaxExtent);
    require(in_range(least, 1 / kMaxNumber), "least");
    for (size_t i = 0; i < chain.size(); ++i) {
      require(chain.data()[i] >= 0 && size_t(chain.data()[i]) < joints(), "chain");
      chain_.push_back(size_t(chain.data()[i]));
    }
  }

 protected:
  void charge(const double* q, size_t n, double* value, double* slope) const override {
    const size_t nq = joints(), m = chain_.size();
    std::vector<Ride> ride(n);
    core_.ride(q, n, link_, tool_.data(), ride.data());
    std::vector<Column> J(m), B(m);
    for (size_t k = 0; k < n; ++k) {
      for (size_t c = 0; c < m; ++c)
        for (size_t i = 0; i < 3; ++i)
          J[c].v[i] = ride[k].J[i * nq + chain_[c]], J[c].v[3 + i] = ride[k].turn[i * nq + chain_[c]];
      const double w = manipulability(J, B), lack = std::max(0.0, 1 - w / least_);
      value[k] = lack * lack;
      if (!slope) continue;
      std::fill_n(slope + k * nq, nq, 0.0);
      for (size_t i = 0; lack > 0 && i < m; ++i) slope[k * nq + chain_[i]] = -2 * lack / least_ * w * turned(J, B, i);
    }
  }

 private:
  struct Column {
    double v[6];  // linear, then angular
  };
  static constexpr double kDamping = 1e-12;  // added to J J^T, so that it can be inverted

  // Returns sqrt(det(J J^T)) and computes B = (J J^T)^-1 J, by a Cholesky factor.
  static double manipulability(const std::vector<Column>& J, std::vector<Column>& B) {
    double L[6][6] = {}, w = 1;
    for (int r = 0; r < 6; ++r)
      for (int c = 0; c <= r; ++c) {
        double sum = r == c ? kDamping : 0.0;
        for (const Column& column : J) sum += column.v[r] * column.v[c];
        for (int i = 0; i < c; ++i) sum -= L[r][i] * L[c][i];
        L[r][c] = r == c ? std::sqrt(std::max(sum, kDamping * kDamping)) : sum / L[c][c];
        if (r == c) w *= L[r][c];
      }
    for (size_t k = 0; k < J.size(); ++k) {
      double* y = B[k].v;
      for (int r = 0; r < 6; ++r) {
        y[r] = J[k].v[r];
        for (int i = 0; i < r; ++i) y[r] -= L[r][i] * y[i];
        y[r] /= L[r][r];
      }
      for (int r = 5; r >= 0; --r) {
        for (int i = r + 1; i < 6; ++i) y[r] -= L[i][r] * y[i];
        y[r] /= L[r][r];
      }
    }
    return w;
  }

  // The derivative of ln w with respect to joint i: the sum of B times the derivative of J. The joint turns the columns
  // of the joints beyond it; for those before it, it moves the point.
  static double turned(const std::vector<Column>& J, const std::vector<Column>& B, size_t i) {
    double sum = 0, d[3];
    for (size_t c = 0; c < J.size(); ++c) {
      const double *about = c < i ? J[c].v + 3 : J[i].v + 3, *moved = c < i ? J[i].v : J[c].v;
      cross(about, moved, d);
      for (int r = 0; r < 3; ++r) sum += B[c].v[r] * d[r];
      if (c < i) continue;
      cross(J[i].v + 3, J[c].v + 3, d);
      for (int r = 0; r < 3; ++r) sum += B[c].v[3 + r] * d[r];
    }
    return sum;
  }
  static void cross(const double* a, const double* b, double* out) {
    for (int i = 0; i < 3; ++i) out[i] = a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3];
  }

  const int link_;
  const Point tool_;
  const double least_;
  std::vector<size_t> chain_;
};

}  // namespace gp
