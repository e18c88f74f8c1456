// The tables of a scene, as Python passes them, and the kernels that read them.
#pragma once
#include <algorithm>
#include <limits>
#include <string>
#include <tuple>
#include <vector>

#include "search/planning.hpp"
#include "cells.hpp"
#include "checks.hpp"
#include "tables.hpp"

namespace gp {

struct Isa {
  const char* name;
  const Kernels* kernels;
};

// All instruction sets that this machine supports, best first.
inline std::vector<Isa> available() {
  std::vector<Isa> found;
#if defined(__x86_64__) && !defined(GP_QUICK)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd"))
    found.push_back({"x86-64-v4", &kernels_v4});
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) found.push_back({"x86-64-v3", &kernels_v3});
#endif
  found.push_back({"baseline", &kernels_baseline});
  return found;
}

inline Isa choose(const std::string& isa) {
  for (const Isa& candidate : available())
    if (isa == "auto" || isa == candidate.name) return candidate;
  throw std::invalid_argument("this machine cannot run instruction set " + isa);
}

// Solve A y = b by Cramer's rule; A is positive definite.
inline void solve3(const double A[3][3], const double b[3], double y[3]) {
  const auto det = [](const double M[3][3]) {
    return M[0][0] * (M[1][1] * M[2][2] - M[1][2] * M[2][1]) - M[0][1] * (M[1][0] * M[2][2] - M[1][2] * M[2][0]) +
           M[0][2] * (M[1][0] * M[2][1] - M[1][1] * M[2][0]);
  };
  for (int k = 0; k < 3; ++k) {
    double M[3][3];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) M[i][j] = j == k ? b[i] : A[i][j];
    y[k] = det(M) / det(A);
  }
}

// The tables of a scene, as Python passes them; core/arrays.py documents their fields.
struct RobotArrays {
  Integers parent, joint, slide;
  Reals X_PL;
  int n_joint;
  Integers sphere_link;
  Reals sphere, bound;
  Integers self_pair;
  Reals self_slack;
  int tool_link;
  Reals tool_position;
};

struct WorldArrays {
  Integers kind;
  Reals pose, size, bound;
  Bits ignores;
  Integers hull_start;
  Reals triangles;
  Reals keep;
};

struct BoundArrays {
  Integers cone_link;
  Reals cone_axis, cone_direction, cone_angle;
  Integers room_link;
  Reals room_point, room_rotation, room_position, room_lower, room_upper;
};

struct ImpactArrays {
  Integers part_component, part_link;
  Reals part_box;
  Integers target_entity;
  Reals target_box;
  int n_component, n_entity;
};

class Core {
 public:
  Core(const RobotArrays& robot, const WorldArrays& world, const ImpactArrays& impact_tables, const BoundArrays& bounds,
       const std::string& isa)
      : isa_(choose(isa)), tool_link_(robot.tool_link) {
    const Reals& tool_position = robot.tool_position;
    const Integers& self_pair = robot.self_pair;
    const int n_link = int(robot.parent.size());
    require_numbers(robot.self_slack, self_pair.size() / 2, "one slack per pair of links");
    require(self_pair.size() % 2 == 0, "pairs of links");
    require_within(self_pair, 0, n_link, "pair of links");
    require(tool_link_ >= 0 && tool_link_ < n_link, "tool");
    require_numbers(tool_position, 3, "tool", kMaxExtent);
    std::copy(tool_position.data(), tool_position.data() + 3, tool_position_);
    add_links(robot);
    add_groups(robot.sphere_link, robot.sphere, robot.bound);
    for (size_t p = 0; p < self_pair.size() / 2; ++p) {
      const int a = group_of_[size_t(self_pair.data()[2 * p])], b = group_of_[size_t(self_pair.data()[2 * p + 1])];
      if (a < 0 || b < 0) continue;
      require(robot.self_slack.data()[p] <= 0, "slack of a pair of links");
      pair_.insert(pair_.end(), {a, b});
      slack_.push_back(float(robot.self_slack.data()[p]));
    }
    add_triangles(world.triangles);
    add_obstacles(world);
    add_impact_tables(impact_tables);
    add_bounds(bounds);
    tables_.n_joint = robot.n_joint, tables_.n_link = int(link_.size()), tables_.n_group = int(group_.size());
    tables_.n_cluster = int(cluster_.size());
    tables_.n_obstacle = int(obstacle_.size()), tables_.n_pair = int(pair_.size() / 2);
    tables_.link = link_.data(), tables_.group = group_.data(), tables_.cluster = cluster_.data();
    pack_clusters();
    tables_.sphere = sphere_.data(), tables_.packed = packed_.data(), tables_.obstacle = obstacle_.data();
    tables_.triangle = triangle_.data(), tables_.pair = pair_.data(), tables_.slack = slack_.data(),
    tables_.part = part_.data(), tables_.target = target_.data();
    tables_.harmed = harmed_.data();
    Cells cells(obstacle_);
    cell_ = std::move(cells.cell), order_ = std::move(cells.order);
    tables_.n_boundless = cells.n_boundless, tables_.n_cell = int(cell_.size());
    tables_.cell = cell_.data(), tables_.order = order_.data();
  }

  const Tables& tables() const { return tables_; }
  const Kernels& kernels() const { return *isa_.kernels; }
  std::string isa() const { return isa_.name; }
  int lanes() const { return isa_.kernels->lanes; }

  size_t rows(const Reals& q) const {
    require_rows(q, tables_.n_joint, "configurations are [n, nq], numbers of at most 1000 rad or m");
    return q.shape(0);
  }
  States states(const Reals& q) const { return {q.data(), nullptr, rows(q)}; }
  States states(const Reals& q, const Reals& qd) const {
    require(rows(qd) == rows(q), "q and qd differ in length");
    return {q.data(), qd.data(), rows(q)};
  }
  Edges edges(const Reals& q0, const Reals& q1, double step) const {
    require(rows(q1) == rows(q0), "q0 and q1 differ in length");
    const size_t nq = size_t(tables_.n_joint), n = q0.shape(0);
    double longest = 0;
    for (size_t i = 0; i < n * nq; ++i) longest = std::max(longest, std::fabs(q1.data()[i] - q0.data()[i]));
    longest *= std::sqrt(double(nq));
    require(in_range(step, kLeastStep) && longest <= step * kMaxSamples, "step of an edge");
    return {q0.data(), q1.data(), n, step};
  }

  auto link_poses(Reals q) const {
    double* out;
    auto array = make<double>({rows(q), size_t(tables_.n_link), 4, 4}, out);
    kernels().link_poses(tables_, states(q), out);
    return array;
  }
  auto free_states(Reals q, double margin) const {
    bool* out;
    auto array = make<bool>({rows(q)}, out);
    require(in_range(margin, -kMaxExtent, kMaxExtent), "margin");
    kernels().free_states(tables_, states(q), margin, reinterpret_cast<uint8_t*>(out));
    return array;
  }
  auto free_edges(Reals q0, Reals q1, double step, double margin) const {
    bool* out;
    auto array = make<bool>({rows(q0)}, out);
    const Edges all = edges(q0, q1, step);
    require(in_range(margin, -kMaxExtent, kMaxExtent), "margin");
    kernels().free_edges(tables_, all, margin, reinterpret_cast<uint8_t*>(out));
    return array;
  }
  auto projected(Reals q, Reals lower, Reals upper, double clearance) const {
    double* out;
    const States all = states(q);
    const size_t nq = size_t(tables_.n_joint);
    auto array = make<double>({all.n, nq}, out);
    require_limits(lower, upper);
    require(in_range(clearance, -kMaxExtent, kMaxExtent), "clearance");
    std::copy_n(all.q, all.n * nq, out);
    for (size_t k = 0; has_bounds() && k < all.n; ++k) project(out + k * nq, lower.data(), upper.data(), clearance);
    return array;
  }
  auto clearance(Reals q) const {
    double* out;
    auto array = make<double>({rows(q)}, out);
    kernels().clearance(tables_, states(q), std::numeric_limits<double>::infinity(), out, nullptr);
    return array;
  }
  auto clearance_gradient(Reals q) const {
    double *out, *gradient;
    auto values = make<double>({rows(q)}, out);
    auto gradients = make<double>({q.shape(0), size_t(tables_.n_joint)}, gradient);
    kernels().clearance(tables_, states(q), std::numeric_limits<double>::infinity(), out, gradient);
    return std::tuple(std::move(values), std::move(gradients));
  }
  auto interaction(Reals q) const {
    double* out;
    auto array = make<double>({rows(q), size_t(tables_.n_component), size_t(tables_.n_entity)}, out);
    kernels().interaction(tables_, states(q), out);
    return array;
  }
  // Moves seeds towards poses [n, 3, 4] by damped least squares. Returns the final configurations and their remaining
  // twists to the poses.
  auto reach(Reals seed, Reals X_WG, Integers free_yaw, Reals radius, Reals X_LT, Reals lower, Reals upper,
             Integers held, Reals ease, int iterations, int patience) const {
    double *q, *missing;
    const size_t n = rows(seed), nq = size_t(tables_.n_joint);
    require_numbers(X_WG, 12 * n, "one pose per seed");
    require_numbers(X_LT, 16, "pose of the tool in its link", kMaxExtent);
    require(free_yaw.size() == n, "one free-yaw flag per pose");
    require(held.size() == nq, "one held flag per joint");
    require(radius.size() == 2 * n, "two radii per pose");
    for (size_t k = 0; k < 2 * n; ++k) require(radius.data()[k] >= 0, "radii of poses");
    require_positive(ease, nq, "ease of each joint");
    require_limits(lower, upper);
    require(iterations >= 0 && patience >= 1, "iterations");
    auto ended = make<double>({n, nq}, q), twists = make<double>({n, 6}, missing);
    kernels().reach(tables_,
                    {seed.data(), X_WG.data(), free_yaw.data(), radius.data(), n, X_LT.data(), tool_link_, lower.data(),
                     upper.data(), held.data(), ease.data(), iterations, patience},
                    q, missing);
    return std::tuple(std::move(ended), std::move(twists));
  }
  // e^x and ln e^x as the drop model computes them, for tests.
  auto elementary(Reals x) const {
    double *exponential, *logarithm;
    require_numbers(x, "exponents");
    auto first = make<double>({x.size()}, exponential);
    auto second = make<double>({x.size()}, logarithm);
    kernels().elementary(x.data(), x.size(), exponential, logarithm);
    return std::tuple(std::move(first), std::move(second));
  }

  // The Jacobian J of the tool's position, and gram = J J^T, damped.
  struct ToolMotion {
    double J[3][kMaxJoints] = {}, gram[3][3] = {};

    // d += scale J^T (J J^T)^-1 step
    void add(const double step[3], double scale, int n_joint, double* d) const {
      double y[3];
      solve3(gram, step, y);
      for (int j = 0; j < n_joint; ++j)
        for (int i = 0; i < 3; ++i) d[j] += scale * J[i][j] * y[i];
    }
  };

  ToolMotion tool_motion(const double* q) const {
    ToolMotion motion;
    double X[kMaxLinks * 16], tool[3];
    kernels().link_poses(tables_, {q, nullptr, 1}, X);
    const double* T = X + 16 * tool_link_;
    for (int r = 0; r < 3; ++r) {
      tool[r] = T[4 * r + 3];
      for (int c = 0; c < 3; ++c) tool[r] += T[4 * r + c] * tool_position_[c];
    }
    for (int l = tool_link_; l >= 0; l = link_[size_t(l)].parent) {
      const Link& link = link_[size_t(l)];
      if (link.joint < 0) continue;
      const double* L = X + 16 * l;
      const double z[3] = {L[2], L[6], L[10]}, r[3] = {tool[0] - L[3], tool[1] - L[7], tool[2] - L[11]};
      for (int i = 0; i < 3; ++i) {
        const int a = (i + 1) % 3, b = (i + 2) % 3;
        motion.J[i][link.joint] = link.slide ? z[i] : z[a] * r[b] - z[b] * r[a];
      }
    }
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < tables_.n_joint; ++j) motion.gram[i][k] += motion.J[i][j] * motion.J[k][j];
      motion.gram[i][i] += 1e-4;  // damps steps near singular postures
    }
    return motion;
  }

  void keep_tool(const double* q, double* d) const {
    const ToolMotion motion = tool_motion(q);
    double moved[3] = {};
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < tables_.n_joint; ++j) moved[i] += motion.J[i][j] * d[j];
    motion.add(moved, -1.0, tables_.n_joint, d);
  }
  void move_tool(const double* q, const double* step, double* d) const {
    std::fill(d, d + tables_.n_joint, 0.0);
    tool_motion(q).add(step, 1.0, tables_.n_joint, d);
  }

  bool has_bounds() const { return !cone_.empty() || !room_.empty(); }

  // Applies Newton's method to the bound with the least clearance, until the clearance of all is `wanted` [m].
  bool project(double* q, const double* lower, const double* upper, double wanted) const {
    constexpr int kSteps = 30;        // of Newton's method
    constexpr double kLongest = 0.5;  // longest step [rad]
    const size_t nq = size_t(tables_.n_joint);
    Ride ride;
    Point X(link_.size() * 16), gradient(nq), least_gradient(nq);
    for (int step = 0; step <= kSteps; ++step) {
      kernels().link_poses(tables_, {q, nullptr, 1}, X.data());
      double least = std::numeric_limits<double>::infinity();
      for (const Cone& cone : cone_) {
        const double value = cone_clearance(X.data(), cone, ride, gradient);
        if (value < least) least = value, least_gradient = gradient;
      }
      for (const Room& room : room_) {
        const double value = room_clearance(X.data(), room, ride, gradient);
        if (value < least) least = value, least_gradient = gradient;
      }
      if (least >= wanted) return true;
      double squared = 0;
      for (size_t j = 0; j < nq; ++j) {
        const double d = least_gradient[j];
        if (d > 0 ? q[j] >= upper[j] : q[j] <= lower[j]) least_gradient[j] = 0;  // the limit blocks this joint
        squared += least_gradient[j] * least_gradient[j];
      }
      if (step == kSteps || squared < 1e-12) return false;
      // A little further than wanted, since the last steps would otherwise be many.
      const double length = (wanted - least + 0.1 * wanted + 1e-5) / squared;
      const double shrink = std::min(1.0, kLongest / (length * std::sqrt(squared)));
      for (size_t j = 0; j < nq; ++j) q[j] = std::clamp(q[j] + shrink * length * least_gradient[j], lower[j], upper[j]);
    }
    return false;
  }

  // Evaluates a point of a link in n configurations, stored as rows.
  void ride(const double* q, size_t n, int link, const double* point, Ride* out) const {
    const size_t nq = size_t(tables_.n_joint), row = link_.size() * 16;
    Point poses(n * row);
    kernels().link_poses(tables_, {q, nullptr, n}, poses.data());
    for (size_t k = 0; k < n; ++k) ride_on(&poses[k * row], link, point, nq, out[k]);
  }
  void ride_on(const double* X, int link, const double* point, size_t nq, Ride& out) const {
    const double* L = X + 16 * link;
    for (int r = 0; r < 3; ++r) {
      out.p[r] = L[4 * r + 3];
      for (int c = 0; c < 3; ++c) out.R[3 * r + c] = L[4 * r + c], out.p[r] += L[4 * r + c] * point[c];
    }
    out.J.assign(3 * nq, 0.0), out.turn.assign(3 * nq, 0.0);
    for (int l = link; l >= 0; l = link_[size_t(l)].parent) {
      const Link& joint = link_[size_t(l)];
      if (joint.joint < 0) continue;
      const double* J = X + 16 * l;
      const double z[3] = {J[2], J[6], J[10]}, r[3] = {out.p[0] - J[3], out.p[1] - J[7], out.p[2] - J[11]};
      for (size_t i = 0; i < 3; ++i) {
        const size_t a = (i + 1) % 3, b = (i + 2) % 3, at = i * nq + size_t(joint.joint);
        out.J[at] = joint.slide ? z[i] : z[a] * r[b] - z[b] * r[a];
        out.turn[at] = joint.slide ? 0.0 : z[i];
      }
    }
  }

  // A point of a link with the joints that move it.
  Rider rider(int link, const Vector3& point) const {
    require(link >= 0 && size_t(link) < link_.size(), "link");
    Rider rider{size_t(link), point, {}};
    for (int l = link; l >= 0; l = link_[size_t(l)].parent)
      if (link_[size_t(l)].joint >= 0)
        rider.movers.push_back({size_t(link_[size_t(l)].joint), size_t(l), link_[size_t(l)].slide != 0});
    std::reverse(rider.movers.begin(), rider.movers.end());
    return rider;
  }

  int frame(int link) const {
    require(link >= 0 && size_t(link) < link_.size(), "link");
    return link_[size_t(link)].frame;
  }

 private:
  void require_limits(const Reals& lower, const Reals& upper) const {
    const size_t nq = size_t(tables_.n_joint);
    require_numbers(lower, nq, "limits"), require_numbers(upper, nq, "limits");
    for (size_t j = 0; j < nq; ++j) require(lower.data()[j] <= upper.data()[j], "limits");
  }
  void add_links(const RobotArrays& robot) {
    const Integers &parent = robot.parent, &joint = robot.joint, &slide = robot.slide;
    const Reals& X_PL = robot.X_PL;
    const int n_joint = robot.n_joint;
    require(parent.size() >= 1 && parent.size() <= size_t(kMaxLinks), "number of links");
    require(n_joint >= 1 && n_joint <= kMaxJoints, "number of joints");
    const int n = int(parent.size());
    require(joint.size() == size_t(n) && slide.size() == size_t(n), "joints of links");
    require_within(joint, -1, n_joint, "joint of a link");
    require_numbers(X_PL, 16 * size_t(n), "poses of links", kMaxExtent);
    for (int l = 0; l < n; ++l) {
      Link link{};
      link.parent = parent.data()[l], link.joint = joint.data()[l], link.slide = slide.data()[l];
      require(l == 0 ? link.parent == -1 : link.parent >= 0 && link.parent < l, "parents of links are not first");
      link.frame = l == 0 || link.joint >= 0 ? l : link_[size_t(link.parent)].frame;
      for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) link.R[3 * r + c] = X_PL.data()[16 * l + 4 * r + c];
        link.p[r] = X_PL.data()[16 * l + 4 * r + 3];
      }
      link_.push_back(link);
    }
  }
  void add_groups(const Integers& sphere_link, const Reals& sphere, const Reals& bound) {
    require(sphere_link.size() <= size_t(kMaxSpheres), "number of spheres");
    const int n = int(sphere_link.size());
    require_numbers(sphere, 4 * size_t(n), "spheres", kMaxExtent);
    require_numbers(bound, 4 * link_.size(), "bounding spheres of links", kMaxExtent);
    for (int k = 0; k < 4 * n; ++k) sphere_.push_back(float(sphere.data()[k]));
    group_of_.assign(link_.size(), -1);
    for (int k = 0; k < n;) {
      const int l = sphere_link.data()[k];
      require(l >= 0 && l < int(link_.size()) && (k == 0 || sphere_link.data()[k - 1] < l), "spheres ordered by link");
      Group group{l, link_[size_t(l)].frame, k, 0, int(cluster_.size()), 0, {}};
      while (k < n && sphere_link.data()[k] == l) ++k, ++group.count;
      add_clusters(group.first, group.count);
      group.n_cluster = int(cluster_.size()) - group.first_cluster;
      for (int i = 0; i < 4; ++i) group.bound[i] = float(bound.data()[4 * l + i]);
      group_of_[size_t(l)] = int(group_.size());
      group_.push_back(group);
    }
  }
  // Recursively halves a range of spheres along its longest side until the parts are small, sorting the spheres within
  // it.
  void add_clusters(int first, int count) {
    struct Ball {
      float v[4];
    };
    Ball* balls = reinterpret_cast<Ball*>(sphere_.data()) + first;
    if (count > kClusterSize) {
      float low[3], high[3];
      int axis = 0;
      for (int i = 0; i < 3; ++i) {
        low[i] = high[i] = balls[0].v[i];
        for (int k = 0; k < count; ++k)
          low[i] = std::min(low[i], balls[k].v[i]), high[i] = std::max(high[i], balls[k].v[i]);
        if (high[i] - low[i] > high[axis] - low[axis]) axis = i;
      }
      std::stable_sort(balls, balls + count, [axis](const Ball& a, const Ball& b) { return a.v[axis] < b.v[axis]; });
      add_clusters(first, count / 2);
      return add_clusters(first + count / 2, count - count / 2);
    }
    Cluster cluster{first, count, {}};
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < count; ++k) cluster.bound[i] += balls[k].v[i] / float(count);
    }
    for (int k = 0; k < count; ++k) {
      float d2 = 0;
      for (int i = 0; i < 3; ++i) d2 += (balls[k].v[i] - cluster.bound[i]) * (balls[k].v[i] - cluster.bound[i]);
      cluster.bound[3] = std::max(cluster.bound[3], std::sqrt(d2) * (1 + 1e-6f) + balls[k].v[3]);
    }
    cluster_.push_back(cluster);
  }
  void pack_clusters() {
    packed_.assign(cluster_.size() * 4 * kPackedSize, 0.f);
    for (size_t c = 0; c < cluster_.size(); ++c) {
      float* row = packed_.data() + c * 4 * kPackedSize;
      std::fill_n(row + 3 * kPackedSize, kPackedSize, -1e30f);
      for (int k = 0; k < cluster_[c].count; ++k)
        for (int i = 0; i < 4; ++i) row[i * kPackedSize + k] = sphere_[size_t(4 * (cluster_[c].first + k) + i)];
    }
  }
  void add_triangles(const Reals& triangles) {
    require(triangles.size() % 9 == 0 && triangles.size() < size_t(kMaxNumber), "corners of triangles");
    require_numbers(triangles, "corners of triangles", kMaxExtent);
    for (size_t k = 0; k < triangles.size() / 9; ++k) {
      const double* v = triangles.data() + 9 * k;
      Triangle t{};
      double e[3], f[3], length = 0;
      for (int i = 0; i < 3; ++i) {
        t.a[i] = float(v[i]), t.b[i] = float(v[3 + i]), t.c[i] = float(v[6 + i]);
        e[i] = v[3 + i] - v[i], f[i] = v[6 + i] - v[i];
      }
      const double n[3] = {e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]};
      for (double x : n) length += x * x;
      length = std::sqrt(length);
      require(length > 0, "degenerate triangle");
      double offset = 0;
      for (int i = 0; i < 3; ++i) t.normal[i] = float(n[i] / length), offset += n[i] / length * v[i];
      t.offset = float(offset);
      for (size_t i = 0; i < 3; ++i) add_edge(v + 3 * i, v + 3 * ((i + 1) % 3), t, i);
      triangle_.push_back(t);
    }
  }
  static void add_edge(const double* a, const double* b, Triangle& t, size_t i) {
    double e[3], inward[3], squared = 1e-20, across = 0;
    for (int k = 0; k < 3; ++k) e[k] = double(float(b[k])) - double(float(a[k])), squared += e[k] * e[k];
    for (int k = 0; k < 3; ++k) {
      const int l = (k + 1) % 3, m = (k + 2) % 3;
      inward[k] = t.normal[l] * e[m] - t.normal[m] * e[l];
      across += inward[k] * double(float(a[k]));
    }
    for (int k = 0; k < 3; ++k) t.edge[i][k] = float(e[k]), t.inward[i][k] = float(inward[k] / std::sqrt(squared));
    t.edge[i][3] = float(1 / squared), t.inward[i][3] = float(across / std::sqrt(squared));
  }
  void add_obstacles(const WorldArrays& world) {
    const auto& [kind, pose, size, bound, ignores, hull_start, triangles, keep] = world;
    const size_t n = kind.size();
    require_numbers(keep, n, "one distance to keep per obstacle", kMaxExtent);
    require_numbers(pose, 12 * n, "poses of obstacles", kMaxExtent);
    require_numbers(size, 3 * n, "sizes of obstacles", kMaxExtent);
    require_numbers(bound, 4 * n, "bounding spheres of obstacles", 2 * kMaxExtent);
    require(ignores.size() == n && hull_start.size() == n + 1, "ignored links and hull ranges of obstacles");
    require_within(hull_start, 0, int(triangle_.size()) + 1, "hull range");
    for (size_t j = 0; j < n; ++j) {
      Obstacle o{};
      o.kind = kind.data()[j], o.ignores = ignores.data()[j], o.keep = float(keep.data()[j]);
      require(o.keep >= 0, "distance to keep");
      require(o.kind >= kPlane && o.kind <= kMesh, "obstacle kind");
      for (int k = 0; k < 9; ++k) o.R[k] = float(pose.data()[12 * j + size_t(k)]);
      for (int k = 0; k < 3; ++k)
        o.p[k] = float(pose.data()[12 * j + 9 + size_t(k)]), o.size[k] = float(size.data()[3 * j + size_t(k)]);
      for (int k = 0; k < 4; ++k) o.bound[k] = float(bound.data()[4 * j + size_t(k)]);
      o.first_triangle = hull_start.data()[j], o.n_triangle = hull_start.data()[j + 1] - o.first_triangle;
      require(o.n_triangle >= 0, "hull range");
      require(o.kind != kMesh || o.n_triangle > 0, "mesh without triangles");
      for (float side : o.size) require(o.kind != kEllipsoid ? side >= 0 : side > 0, "size of an obstacle");
      obstacle_.push_back(o);
    }
  }
  void add_impact_tables(const ImpactArrays& impact_tables) {
    const auto& [component, link, box, entity, target_box, n_component, n_entity] = impact_tables;
    require(n_component >= 0 && n_component <= kMaxComponents, "number of components");
    require(n_entity >= 0 && n_entity <= kMaxEntities, "number of entities");
    require(component.size() <= size_t(kMaxParts), "number of parts");
    require(link.size() == component.size(), "links of parts");
    require_numbers(box, 15 * component.size(), "boxes of parts", kMaxExtent);
    require_numbers(target_box, 6 * entity.size(), "boxes of entities", 2 * kMaxExtent);
    for (size_t k = 0; k < component.size(); ++k) {
      Part part{};
      part.component = component.data()[k];
      require(part.component >= 0 && part.component < n_component, "component of a part");
      require(k == 0 || component.data()[k - 1] <= part.component, "parts ordered by component");
      require(link.data()[k] >= 0 && size_t(link.data()[k]) < link_.size(), "link of a part");
      part.frame = link_[size_t(link.data()[k])].frame;
      const double* b = box.data() + 15 * k;
      for (int i = 0; i < 9; ++i) part.R[i] = b[i];
      for (int i = 0; i < 3; ++i) part.p[i] = b[9 + i], part.half[i] = b[12 + i];
      part_.push_back(part);
    }
    harmed_.assign(size_t(n_entity), Harmed{0, 0, 0.0, {0, {1e9, 1e9, 1e9}, {-1e9, -1e9, -1e9}}});
    for (size_t k = 0; k < entity.size(); ++k) {
      Target t{};
      t.entity = entity.data()[k];
      require(t.entity >= 0 && t.entity < n_entity && (k == 0 || entity.data()[k - 1] <= t.entity),
              "targets ordered by entity");
      for (int i = 0; i < 3; ++i)
        t.lower[i] = target_box.data()[6 * k + size_t(i)], t.upper[i] = target_box.data()[6 * k + 3 + size_t(i)];
      Harmed& harmed = harmed_[size_t(t.entity)];
      if (harmed.first == harmed.last) harmed.first = int(k);
      harmed.last = int(k) + 1;
      harmed.area += (t.upper[0] - t.lower[0]) * (t.upper[1] - t.lower[1]);
      for (int i = 0; i < 3; ++i) {
        harmed.bound.lower[i] = std::min(harmed.bound.lower[i], t.lower[i]);
        harmed.bound.upper[i] = std::max(harmed.bound.upper[i], t.upper[i]);
      }
      target_.push_back(t);
    }
    tables_.n_part = int(part_.size()), tables_.n_target = int(target_.size());
    tables_.n_component = n_component, tables_.n_entity = n_entity;
  }

  double cone_clearance(const double* X, const Cone& cone, Ride& ride, Point& gradient) const {
    const size_t nq = size_t(tables_.n_joint);
    const double origin[3] = {0, 0, 0};
    ride_on(X, cone.link, origin, nq, ride);
    double axis[3], about[3], cosine = 0, sine = 0;
    for (size_t i = 0; i < 3; ++i) {
      axis[i] = ride.R[3 * i] * cone.axis[0] + ride.R[3 * i + 1] * cone.axis[1] + ride.R[3 * i + 2] * cone.axis[2];
      cosine += axis[i] * cone.direction[i];
    }
    for (size_t i = 0; i < 3; ++i) {
      const size_t a = (i + 1) % 3, b = (i + 2) % 3;
      about[i] = axis[a] * cone.direction[b] - axis[b] * cone.direction[a];
      sine += about[i] * about[i];
    }
    sine = std::sqrt(sine);
    for (size_t j = 0; j < nq; ++j) {
      gradient[j] = 0;
      for (size_t i = 0; i < 3; ++i) gradient[j] += kLever * ride.turn[i * nq + j] * about[i] / (sine + 1e-9);
    }
    return kLever * (cone.angle - std::atan2(sine, cosine));
  }
  double room_clearance(const double* X, const Room& room, Ride& ride, Point& gradient) const {
    const size_t nq = size_t(tables_.n_joint);
    ride_on(X, room.link, room.point, nq, ride);
    double least = std::numeric_limits<double>::infinity();
    for (size_t i = 0; i < 3; ++i) {
      double along = 0;
      for (size_t k = 0; k < 3; ++k) along += (ride.p[k] - room.p[k]) * room.R[3 * k + i];
      for (double side : {1.0, -1.0}) {
        const double inside = side > 0 ? along - room.lower[i] : room.upper[i] - along;
        if (inside >= least) continue;
        least = inside;
        for (size_t j = 0; j < nq; ++j) {
          gradient[j] = 0;
          for (size_t k = 0; k < 3; ++k) gradient[j] += side * room.R[3 * k + i] * ride.J[k * nq + j];
        }
      }
    }
    return least;
  }

  void add_bounds(const BoundArrays& bounds) {
    const auto rides_on = [&](int link) {
      require(link >= 0 && size_t(link) < link_.size(), "link of a bound");
      return link_[size_t(link)].frame;
    };
    const size_t n_cone = bounds.cone_link.size(), n_room = bounds.room_link.size();
    require_numbers(bounds.cone_axis, 3 * n_cone, "axes of cones", kMaxExtent);
    require_numbers(bounds.cone_direction, 3 * n_cone, "directions of cones", kMaxExtent);
    require_numbers(bounds.cone_angle, n_cone, "angles of cones", kMaxExtent);
    require_numbers(bounds.room_point, 3 * n_room, "points in rooms", kMaxExtent);
    require_numbers(bounds.room_rotation, 9 * n_room, "rotations of rooms", kMaxExtent);
    require_numbers(bounds.room_position, 3 * n_room, "positions of rooms", kMaxExtent);
    for (const Reals& corners : {bounds.room_lower, bounds.room_upper}) {
      require(corners.size() == 3 * n_room, "corners of rooms");
      for (size_t i = 0; i < corners.size(); ++i)  // sides may be infinitely far away
        require(!std::isnan(corners.data()[i]), "corners of rooms");
    }
    const auto row = [](const Reals& rows, size_t k, auto& out) {
      std::copy_n(rows.data() + k * std::size(out), std::size(out), out);
    };
    for (size_t k = 0; k < n_cone; ++k) {
      Cone& cone = cone_.emplace_back();
      cone.link = bounds.cone_link.data()[k], cone.frame = rides_on(cone.link);
      row(bounds.cone_axis, k, cone.axis), row(bounds.cone_direction, k, cone.direction);
      cone.angle = bounds.cone_angle.data()[k];
    }
    for (size_t k = 0; k < n_room; ++k) {
      Room& room = room_.emplace_back();
      room.link = bounds.room_link.data()[k], room.frame = rides_on(room.link);
      row(bounds.room_point, k, room.point);
      row(bounds.room_rotation, k, room.R), row(bounds.room_position, k, room.p);
      row(bounds.room_lower, k, room.lower), row(bounds.room_upper, k, room.upper);
    }
    tables_.n_cone = int(cone_.size()), tables_.n_room = int(room_.size());
    tables_.cone = cone_.data(), tables_.room = room_.data();
  }

  Isa isa_;
  int tool_link_;
  double tool_position_[3];
  Tables tables_{};
  std::vector<Link> link_;
  std::vector<Group> group_;
  std::vector<Cluster> cluster_;
  std::vector<int> group_of_;
  std::vector<float> sphere_;
  std::vector<float> packed_;
  std::vector<Obstacle> obstacle_;
  std::vector<Cell> cell_;
  std::vector<int32_t> order_;
  std::vector<Triangle> triangle_;
  std::vector<int32_t> pair_;
  std::vector<float> slack_;
  std::vector<Part> part_;
  std::vector<Target> target_;
  std::vector<Harmed> harmed_;
  std::vector<Cone> cone_;
  std::vector<Room> room_;
};

// A row, or rows, with one number for each joint of the space.
inline void require_point(const Space& space, const Reals& q, const char* what) {
  require(q.ndim() == 1 && q.size() == size_t(space.dim), what);
  require_numbers(q, what, kMaxPosition);
}
inline void require_points(const Space& space, const Reals& q, const char* what) {
  require_rows(q, space.dim, what);
  require(q.shape(0) > 0, what);
}

inline Point point(const Reals& q) { return Point(q.data(), q.data() + q.size()); }

inline std::vector<Point> points(const Reals& q) {
  std::vector<Point> rows;
  for (size_t i = 0; i < q.shape(0); ++i) rows.emplace_back(q.data() + i * q.shape(1), q.data() + (i + 1) * q.shape(1));
  return rows;
}

}  // namespace gp
