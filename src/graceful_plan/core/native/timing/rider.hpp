// A point on a link: its position, its motion along a curve, and the joints that move it.
#pragma once
#include <array>
#include <cstddef>
#include <vector>

namespace gp {

using Vector3 = std::array<double, 3>;

inline double dot3(const Vector3& a, const Vector3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline Vector3 cross3(const Vector3& a, const Vector3& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline Vector3 scaled3(const Vector3& a, double factor) { return {factor * a[0], factor * a[1], factor * a[2]}; }
inline void add3(Vector3& a, double factor, const Vector3& b) {
  for (size_t i = 0; i < 3; ++i) a[i] += factor * b[i];
}

// The poses of all links in one configuration, [link, 4, 4] in W.
struct LinkPoses {
  const double* X;
  Vector3 origin(size_t link) const { return {X[16 * link + 3], X[16 * link + 7], X[16 * link + 11]}; }
  Vector3 axis(size_t link) const { return {X[16 * link + 2], X[16 * link + 6], X[16 * link + 10]}; }
  Vector3 turned(size_t link, const Vector3& v) const {
    const double* L = X + 16 * link;
    return {dot3({L[0], L[1], L[2]}, v), dot3({L[4], L[5], L[6]}, v), dot3({L[8], L[9], L[10]}, v)};
  }
  // A vector of W in the axes of a link.
  Vector3 within(size_t link, const Vector3& v) const {
    const double* L = X + 16 * link;
    return {dot3({L[0], L[4], L[8]}, v), dot3({L[1], L[5], L[9]}, v), dot3({L[2], L[6], L[10]}, v)};
  }
};

struct Rider {
  struct Mover {  // a joint about, or along, the z axis of its link
    size_t joint, link;
    bool slide;
  };
  size_t link;
  Vector3 point;              // in the link
  std::vector<Mover> movers;  // from the base outwards

  Vector3 at(const LinkPoses& poses) const {
    Vector3 p = poses.turned(link, point);
    add3(p, 1, poses.origin(link));
    return p;
  }

  // The first and second derivatives of the point along a curve, from those of the joints.
  void derive(const LinkPoses& poses, const Vector3& p, const double* slope, const double* bend, Vector3& first,
              Vector3& second) const {
    Vector3 turning{};
    first = second = {};
    for (const Mover& mover : movers) {
      const double s = slope[mover.joint];
      const Vector3 z = poses.axis(mover.link);
      Vector3 J = z, both = turning;
      if (!mover.slide) {
        Vector3 arm = p;
        add3(arm, -1, poses.origin(mover.link));
        J = cross3(z, arm);
        add3(turning, s, z);
      }
      add3(both, 1, turning);
      add3(first, s, J);
      // J rotates with the joints before it and with the joint itself.
      add3(second, bend[mover.joint], J), add3(second, s, cross3(both, J));
    }
  }

  // Maps derivatives with respect to the point's position and the link's rotation to those with respect to the joints.
  void pull_back(const LinkPoses& poses, const Vector3& p, const Vector3& d_p, const Vector3& d_turn,
                 double* d_q) const {
    for (const Mover& mover : movers) {
      const Vector3 z = poses.axis(mover.link);
      if (mover.slide) {
        d_q[mover.joint] += dot3(z, d_p);
        continue;
      }
      Vector3 arm = p;
      add3(arm, -1, poses.origin(mover.link));
      Vector3 about = cross3(arm, d_p);
      add3(about, 1, d_turn);
      d_q[mover.joint] += dot3(z, about);
    }
  }
};

}  // namespace gp
