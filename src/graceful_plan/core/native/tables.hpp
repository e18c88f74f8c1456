// The read-only tables of a scene, as the kernels see them. Owned by `Core` (core.hpp); made by compile.py.
#pragma once
#include <cstddef>
#include <cstdint>

#include "impact/moving/tables.hpp"

namespace gp {

constexpr int kMaxLinks = 48;
constexpr int kMaxJoints = 32;
constexpr int kMaxSpheres = 2048;
constexpr int kMaxObstacles = 4096;  // where the body model is used
constexpr int kClusterSize = 12;     // spheres at most
constexpr int kPackedSize = 16;      // of rows that hold as many, whatever the width of vectors
constexpr int kMaxClusters = kMaxSpheres / (kClusterSize / 2) + kMaxLinks;
constexpr int kMaxParts = 128;
constexpr int kMaxComponents = 3;
constexpr int kMaxEntities = 512;
constexpr int kMaxDropParts = 32;
constexpr int kMaxSurfaces = 512;
constexpr int kMaxSteps = 64;
constexpr int kNetworkInputs = 18;
constexpr int kMaxHidden = 32;

enum Kind : int32_t { kPlane, kSphere, kCapsule, kEllipsoid, kCylinder, kBox, kMesh };

// A link with joint -1 shares the frame of its parent; compile.py sees to it that its X_PL is the identity.
struct Link {
  int32_t parent, joint, slide, frame;
  double R[9], p[3];  // X_PL; for the base X_WB
};

// The spheres of one link, behind one bounding sphere, and behind that in clusters with bounding spheres of their own.
struct Group {
  int32_t link, frame, first, count, first_cluster, n_cluster;
  float bound[4];
};

struct Cluster {
  int32_t first, count;
  float bound[4];
};

struct Obstacle {
  int32_t kind, first_triangle, n_triangle;
  uint64_t ignores;  // bit l: link l may touch it
  float R[9], p[3], size[3], bound[4];
  float keep;  // distance that everything has to keep from it [m]
};

// A box around obstacles that stand near each other, and the boxes inside of it: those up to `next`.
struct Cell {
  float centre[3], half[3];
  float keep;                  // the most of what its obstacles ask for [m]
  int32_t next, first, count;  // of `order`, the obstacles in it if it is a leaf
};

struct Triangle {
  float a[3], b[3], c[3], normal[3], offset;
  float edge[3][4],
      inward[3][4];  // from a to b, b to c, c to a, and 1/length^2; across it in the plane, and where it is
};

// What else has to hold in every configuration. An angle counts as clearance with a lever, so that one margin is for
// all.
constexpr double kLever = 0.25;  // [m/rad]

struct Cone {  // an axis that rides on a frame stays within an angle of a direction of W
  int32_t link, frame;
  double axis[3], direction[3], angle;
};

struct Room {  // a point that rides on a frame stays inside a box
  int32_t link, frame;
  double point[3], R[9], p[3], lower[3], upper[3];
};

struct Part {  // a box of a component, riding on a frame
  int32_t component, frame;
  double R[9], p[3], half[3];
};

struct Target {  // an axis-aligned box of an entity
  int32_t entity;
  double lower[3], upper[3];
};

struct Harmed {  // an entity: its targets, and the box around them
  int32_t first, last;
  double area;  // in xy, over all boxes
  Target bound;
};

struct Tables {
  int32_t n_joint, n_link, n_group, n_cluster, n_obstacle, n_pair, n_part, n_target, n_component, n_entity;
  const Link* link;
  const Group* group;
  const Cluster* cluster;
  const float* sphere;  // x y z r, in the frame of the group's link
  const float* packed;  // per cluster: rows of all x, y, z and r; r is far below 0 where there is no sphere
  const Obstacle* obstacle;
  int32_t n_boundless, n_cell;
  const Cell* cell;
  const int32_t* order;  // obstacles without bounds, then those of the leaves
  const Triangle* triangle;
  const int32_t* pair;  // pairs of groups
  const float* slack;   // per pair: the clearance of their spheres at which they touch [m]; 0 or less
  const Part* part;
  const Target* target;
  const Harmed* harmed;  // per entity; without targets first == last
  int32_t n_cone, n_room;
  const Cone* cone;
  const Room* room;
};

// --- the drop model: costs/models/drop has its specification and the names of what stands here ---------

enum DropShape : int32_t { kFlat, kRound, kBall };

struct DropPart {
  int32_t shape;
  double offset[3], R[9], half[3];  // in the axes of the link; offset from the centre of mass
};

struct Surface {                       // a target: a box turned about the vertical
  int32_t entity, turn, holds, fixed;  // turn: equal for equal axes; holds: wide enough for a fall to end there
  double centre[2], axis[2], half[2], diagonal, carries[2], bottom, top;
  double bound[2];               // half sizes of the box around it in W
  double reached[2], inside[2];  // half sizes for the centre of what tumbles over it: hits it, is caught by it
  double near[2];                // the larger of these
  double catches;                // P that it ends a fall on to its middle
  double strength;               // ln of the energy per mass at which half of what falls on it is damaged [J/kg]
};

// Constants of the model; the order is that of kDropConstants in impact.hpp.
struct DropConstants {
  double delay, velocity_spread, height_spread, carry_spread, side_spread, side_reach, side_height, catches, leave_tilt;
  double position_spread, size_spread, tumble_reach, catch_margin, leave, leave_offset, leave_narrow, leave_speed;
  double drift, carry, slide, topple_reach;
};

// --- the spill model: costs/models/spill ---------------------------------------------------------------------

// Of severities: carried object; contents after a drop; contents that get out in the gripper; those that a stop spills.
constexpr int kDropRows = 4;
constexpr int kStopRow = 3;
constexpr int kSpillUses = 2;        // constants for contents after a drop, and for those that get out in the gripper
constexpr double kLeastLost = 0.01;  // share of the contents that a puddle is made of at least

struct SpillConstants {
  double position_spread, rim_spread, speed_spread, height_spread, carry, margin, reach, run_off, edge, slosh,
      soft_speed, soft_spread;
};

struct SpillSurface {
  int32_t first, end;  // levels that it stands on or beside
  double visible;
};

struct SpillTables {
  double mouth[3], axis[3];  // in the axes of the link; from the centre of mass
  double rim, depth, full, radius, power, repose;
  const SpillSurface* surface;  // null without contents
  SpillConstants use[kSpillUses];
};

// How the robot stops by itself, and what contents make of it.
struct StopTables {
  double amplification, response, spread;  // spread: 0 if it does not
  double slowness[kMaxJoints];             // inverse deceleration
  SpillConstants places;                   // where contents come down that it throws out
};

// What its fall does to the object itself; the logarithm of the share of the energy that acts is one of two numbers.
struct LossTables {
  double sharpness;  // of damage over the logarithm of the energy; 0 if nothing is known
  double shift[2], weight[2];
};

// A network that corrects hits: two layers of `hidden` units. Weights: first [hidden, kNetworkInputs], second
// [hidden, hidden], its biases, last [hidden], its bias, and biases of the first for each surface [n_surface, hidden].
struct DropNetwork {
  int32_t hidden;  // 0 if there is none
  double bound;    // the logarithm of a factor of the odds is within +- that
  const double* weights;
  const float* rough_weights;

  template <class T> const T* of() const {
    if constexpr (sizeof(T) == sizeof(double))
      return weights;
    else
      return rough_weights;
  }
};

struct DropTables {
  int32_t n_part, n_surface, n_level, n_entity, link, frame, main;
  double centre[3], size, radius;  // radius: of a ball around the centre of mass that holds all parts
  const DropPart* part;
  const Surface* surface;      // by top, highest first
  const int32_t* level_start;  // first surface of each level, and their number at the end
  const double* speed;         // per joint: how fast it is along an edge whose slowest joint it is
  DropConstants constants;
  LossTables loss;
  SpillTables spill;
  StopTables stop;
  DropNetwork network;
};

// --- the body model: costs/models/body has its specification and the names of what stands here -------------

struct Inertia {                       // of all that rides on a frame
  double mass, centre[3], inertia[9];  // inertia about the centre, in the frame's axes
};

struct JointDrive {
  int32_t link;
  double lower, upper, armature, damping, friction, resistance, speed;
};

enum BodyGenerator : int32_t { kCollapse, kJoint, kStuck, kStray, kGenerators };

// Spheres that ride on one frame and may hit the same: their centres are in a box, all of them in a ball around it.
struct Limb {
  int32_t frame, row, link;  // row: 0 body, 1 carried; link: one of theirs
  int32_t first, count, first_cluster, n_cluster;
  float centre[3], half[3], radius, bound;  // radius: of the greatest sphere; bound: of the ball
};

// Constants of the model; the order is that of kBodyConstants in body_impact.hpp.
struct BodyConstants {
  double brake_time, brake_stop, step, carry_on;
  double stop_gain[kGenerators], stop_tolerance[kGenerators];
  double offset[kGenerators][2], spread[kGenerators][2];  // of body and carried
};

struct BodyTables {
  int32_t n_frame, n_row, n_entity, n_step, n_reference, n_fall, n_limb;  // n_fall: steps of a collapse
  const Inertia* inertia;                                                 // per frame
  const JointDrive* drive;                                                // per joint
  const Limb* limb;                                                       // the farthest out first
  const int32_t* entity;                                                  // per obstacle, -1 for none
  uint64_t looked_at = ~uint64_t(0);  // a bit for each step of joints that fall: whether anything may be met there
  BodyConstants constants;

  bool looks(int step) const { return step >= 64 || looked_at >> step & 1; }
};

// --- what kernels are asked -----------------------------------------------------------------------------------------

struct States {  // row by row [n, n_joint]; qd null at rest
  const double *q, *qd;
  size_t n;
};

struct Edges {  // straight ones between rows of q0 and q1, looked at every `step` or more often
  const double *q0, *q1;
  size_t n;
  double step;
};

// Poses of the tool to be reached, one for each seed.
struct Reach {
  const double *seed, *X_WG;  // [n, n_joint] inside the limits, [n, 3, 4]
  const int32_t* free_yaw;    // [n]: whether the tool may be turned about its own z axis
  size_t n;
  const double* X_LT;  // [4, 4]: the tool in the frame of its link
  int32_t tool_link;
  const double *lower, *upper;  // [n_joint]
  const int32_t* held;          // [n_joint]: whether a joint stays as it is
  int iterations, patience;     // at most; and after so many, most of what was missing has to be gone
};

struct Slopes {  // a value per state, and its derivatives [n, n_joint]
  double *value, *d_q, *d_qd;
};

// How many spreads off a hit does not count any more, and its probability there; nothing counts where `far` is
// negative.
struct Tail {
  double far, least;
};

struct BodyHarm {  // how much each way to fail counts [mode, row], and whom it hits [row, entity]
  const double *weight, *severity;
  const Tail* tail;  // [generator, row, entity]; null: the model's own
};

// One instruction set's kernels. severity is [n_component, n_entity]; of edges, cost is [n, 2]: length and integral of
// the impact over it.
struct Kernels {
  int lanes;
  void (*link_poses)(const Tables&, const States&, double* X_WL);
  void (*free_states)(const Tables&, const States&, double margin, uint8_t* free);
  void (*free_edges)(const Tables&, const Edges&, double margin, uint8_t* free);
  // Infinite, without a gradient, where nothing is nearer than `far`.
  void (*clearance)(const Tables&, const States&, double far, double* clearance, double* gradient);
  void (*interaction)(const Tables&, const States&, double* probability);
  // Where each seed ended [n, n_joint], and the twist that is missing there [n, 6].
  void (*reach)(const Tables&, const Reach&, double* q, double* missing);
  void (*impact)(const Tables&, const double* severity, const States&, double* impact);
  void (*edge_costs)(const Tables&, const double* severity, const Edges&, double* cost);
  // The drop and spill models; severity and probability are [kDropRows, n_entity].
  void (*drop)(const Tables&, const DropTables&, const States&, double* probability);
  // What the network is told of each surface and P that it is to correct [n_surface, kNetworkInputs + 1].
  void (*drop_sights)(const Tables&, const DropTables&, const States&, double* sights);
  void (*drop_impact)(const Tables&, const DropTables&, const double* severity, const States&, double* impact);
  void (*drop_gradient)(const Tables&, const DropTables&, const double* severity, const States&, const Slopes&);
  void (*drop_edge_costs)(const Tables&, const DropTables&, const double* severity, const double* pace, const Edges&,
                          double* cost);
  // The same in single precision, and with shorter tails: good to some 1e-5 of the greatest severity.
  void (*rough_drop_impact)(const Tables&, const DropTables&, const double* severity, const States&, double* impact);
  void (*rough_drop_gradient)(const Tables&, const DropTables&, const double* severity, const States&, const Slopes&);
  // The body model; ahead null or [n, n_reference, n_joint].
  void (*body)(const Tables&, const BodyTables&, const States&, const double* ahead, double* distance);
  void (*body_impact)(const Tables&, const BodyTables&, const BodyHarm&, const States&, double* impact);
  void (*body_gradient)(const Tables&, const BodyTables&, const BodyHarm&, const States&, const Slopes&);
  void (*body_dynamics)(const Tables&, const BodyTables&, const States&, double* mass_matrix, double* gravity);
  // What a dropped object and a collapsing arm do to entities that move: P [n, n_entity] at times or, if t is null,
  // along their paths; of those without severity it is 0, if severities are given. Gradients of sums of P S, at times.
  void (*moving_drop)(const Tables&, const DropTables&, const MovingPaths&, const MovingPlaces&, const double* severity,
                      const States&, const double* t, double* probability);
  void (*moving_drop_gradient)(const Tables&, const DropTables&, const MovingPaths&, const MovingPlaces&,
                               const double* severity, const States&, const double* t, const MovingSlopes&);
  void (*moving_arm)(const Tables&, const MovingPaths&, const double* severity, const States&, const double* t,
                     double* probability);
  void (*moving_arm_gradient)(const Tables&, const MovingPaths&, const double* severity, const States&, const double* t,
                              const MovingSlopes&);
  // The gap to the nearest entity that moves, infinite where it is not below `wanted`; d_q and d_t null or derivatives.
  void (*moving_gaps)(const Tables&, const MovingPaths&, const States&, const double* t, double wanted, double* gap,
                      double* d_q, double* d_t);
  void (*elementary)(const double* x, size_t n, double* exponential, double* logarithm);
};

extern const Kernels kernels_baseline;
#if defined(__x86_64__)
extern const Kernels kernels_v3;
extern const Kernels kernels_v4;
#endif

}  // namespace gp
