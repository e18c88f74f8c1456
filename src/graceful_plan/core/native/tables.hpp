// The read-only tables of a scene, as the kernels see them. `Core` (core.hpp) owns them; compile.py builds them.
#pragma once
#include <cstddef>
#include <cstdint>

#include "impact/moving/tables.hpp"

namespace gp {

constexpr double kGravity = 9.81;  // gravitational acceleration of the models of failures [m/s^2]

// Capacities of the kernels.
constexpr int kMaxLinks = 48;
constexpr int kMaxJoints = 32;
constexpr int kMaxSpheres = 2048;
constexpr int kMaxObstacles = 4096;  // in the body model
constexpr int kClusterSize = 12;     // most spheres in a cluster
constexpr int kPackedSize = 16;      // spheres per packed row, independent of the vector width
constexpr int kMaxClusters = kMaxSpheres / (kClusterSize / 2) + kMaxLinks;
constexpr int kMaxParts = 128;
constexpr int kMaxComponents = 3;
constexpr int kMaxEntities = 512;
constexpr int kMaxDropParts = 32;
constexpr int kMaxSurfaces = 512;
constexpr int kMaxSteps = 64;
constexpr int kNetworkInputs = 18;  // costs/models/drop/network.py lists them
constexpr int kMaxHidden = 32;      // units of each hidden layer

enum Kind : int32_t { kPlane, kSphere, kCapsule, kEllipsoid, kCylinder, kBox, kMesh };

// A link with joint -1 shares the frame of its parent; compile.py guarantees that its X_PL is the identity.
struct Link {
  int32_t parent, joint, slide, frame;
  double R[9], p[3];  // X_PL: rotation R, position p; X_WB for the base
};

// The spheres of one link, in clusters. The link and each cluster have a bounding sphere.
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
  float keep;  // distance that all links keep from it [m]
};

// A box around neighbouring obstacles, with the boxes inside it; those come next in the array, up to index `next`.
struct Cell {
  float centre[3], half[3];
  float keep;                  // largest distance to keep of its obstacles [m]
  int32_t next, first, count;  // range of `order`: the obstacles of a leaf
};

struct Triangle {
  float a[3], b[3], c[3], normal[3], offset;
  float edge[3][4],
      inward[3][4];  // edge: ab, bc, ca, then 1/length^2; inward: normal of the edge in the plane, then its offset
};

// Bounds beyond collision, for every configuration. An angle times kLever counts as clearance, so that one margin
// applies to distances and angles.
constexpr double kLever = 0.25;  // clearance per angle [m/rad]

struct Cone {  // an axis on a frame stays within an angle of a direction in W
  int32_t link, frame;
  double axis[3], direction[3], angle;
};

struct Room {  // a point on a frame stays inside a box
  int32_t link, frame;
  double point[3], R[9], p[3], lower[3], upper[3];
};

struct Part {  // a box of a component on a frame
  int32_t component, frame;
  double R[9], p[3], half[3];
};

struct Target {  // an axis-aligned box of an entity
  int32_t entity;
  double lower[3], upper[3];
};

struct Harmed {  // an entity: its range of targets, and the box around them
  int32_t first, last;
  double area;  // in xy, summed over all boxes
  Target bound;
};

struct Tables {
  int32_t n_joint, n_link, n_group, n_cluster, n_obstacle, n_pair, n_part, n_target, n_component, n_entity;
  const Link* link;
  const Group* group;
  const Cluster* cluster;
  const float* sphere;  // x y z r, in the frame of the group's link
  const float* packed;  // per cluster: rows of all x, y, z and r; r is far below 0 for missing spheres
  const Obstacle* obstacle;
  int32_t n_boundless, n_cell;
  const Cell* cell;
  const int32_t* order;  // obstacles without bounds, then those in the leaves
  const Triangle* triangle;
  const int32_t* pair;  // pairs of groups
  const float* slack;   // per pair: clearance of its spheres at which the links touch [m], at most 0
  const Part* part;
  const Target* target;
  const Harmed* harmed;  // per entity; first == last without targets
  int32_t n_cone, n_room;
  const Cone* cone;
  const Room* room;
};

// --- the drop model: costs/models/drop specifies it and explains the names of the constants -----------------

enum DropShape : int32_t { kFlat, kRound, kBall };

struct DropPart {
  int32_t shape;
  double offset[3], R[9], half[3];  // in the link's axes; offset from the centre of mass
};

struct Surface {                       // a target: a box turned about the vertical
  int32_t entity, turn, holds, fixed;  // turn: equal for equal axes; holds: wide enough to stop a fall
  double centre[2], axis[2], half[2], diagonal, carries[2], bottom, top;
  double bound[2];               // half sizes of its bounding box in W
  double reached[2], inside[2];  // half sizes for the centre of a tumbling object: hits it, is stopped by it
  double near[2];                // the larger of the two
  double catches;                // P that the surface stops an object whose centre is over its middle
  double strength;               // ln of the energy per mass that damages half of the objects that fall on it [J/kg]
};

// Constants of the model; fields() in impact.hpp names them.
struct DropConstants {
  double delay, velocity_spread, height_spread, carry_spread, side_spread, side_reach, side_height, catches, leave_tilt;
  double position_spread, size_spread, tumble_reach, catch_margin, leave, leave_offset, leave_narrow, leave_speed;
  double drift, carry, slide, topple_reach;
};

// --- the spill model: costs/models/spill ---------------------------------------------------------------------

// Rows of severity: carried object; contents after a drop; contents that leave it in the gripper; contents that a
// protective stop spills.
constexpr int kDropRows = 4;
constexpr int kStopRow = 3;
constexpr int kSpillUses = 2;        // sets of constants: contents after a drop, contents that leave the object in the
                                     // gripper
constexpr double kLeastLost = 0.01;  // least share of the contents that forms a puddle

struct SpillConstants {
  double position_spread, rim_spread, speed_spread, height_spread, carry, margin, reach, run_off, edge, slosh,
      soft_speed, soft_spread;
};

struct SpillSurface {
  int32_t first, end;  // levels that the surface's body stands on or beside
  double visible;
};

struct SpillTables {
  double mouth[3], axis[3];  // in the link's axes; mouth: from the centre of mass
  double rim, depth, full, radius, power, repose;
  const SpillSurface* surface;  // null without contents
  SpillConstants use[kSpillUses];
};

// How the robot brakes in a protective stop, and how contents respond.
struct StopTables {
  double amplification, response, spread;  // spread: 0 without a model of stops
  double slowness[kMaxJoints];             // inverse deceleration
  SpillConstants places;                   // for the places where thrown-out contents land
};

// Own loss of the dropped object. The logarithm of the acting share of the energy has two values, with weights.
struct LossTables {
  double sharpness;  // slope of damage over the logarithm of the energy; 0 if the object has no loss
  double shift[2], weight[2];
};

// Fragility of an entity: its highest point; ln of the energy per mass at which half of the hits do damage; the inverse
// of the spread of that logarithm.
struct Fragility {
  double top, strength, sharpness;
};

// Damage to entities by hits of the dropped object.
struct DamageTables {
  const Fragility* entity;  // null if every hit counts in full
  double loss;              // mean of -ln of the share of the energy that acts
};

// A network that corrects probabilities of hits, with two layers of `hidden` units. Order of the weights: first layer
// [hidden, kNetworkInputs]; second layer [hidden, hidden] and its biases; last layer [hidden] and its bias; biases of
// the first layer for each surface [n_surface, hidden].
struct DropNetwork {
  int32_t hidden;  // 0 if there is none
  double bound;    // largest absolute log factor on the odds
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
  double centre[3], size, radius;  // radius: of a ball around the centre of mass that contains all parts
  const DropPart* part;
  const Surface* surface;      // sorted by top, highest first
  const int32_t* level_start;  // first surface of each level, then n_surface
  const double* speed;         // per joint: its speed on an edge whose slowest joint it is
  DropConstants constants;
  LossTables loss;
  DamageTables damage;
  SpillTables spill;
  StopTables stop;
  DropNetwork network;
};

// --- the body model: costs/models/body specifies it and explains the names of the constants -----------------

struct Inertia {                       // of all bodies on a frame
  double mass, centre[3], inertia[9];  // inertia about the centre, in the frame's axes
};

struct JointDrive {
  int32_t link;
  // Limits; inertia of the rotor, damping, dry friction, further damping without power, speed limit; in SI units.
  double lower, upper, armature, damping, friction, resistance, speed;
};

// Kinds of failure modes: all joints without power, one joint without power, one joint stuck, tracking errors.
enum BodyGenerator : int32_t { kCollapse, kJoint, kStuck, kStray, kGenerators };

// Spheres of one frame that may hit the same obstacles; a box contains their centres, a ball all of them.
struct Limb {
  int32_t frame, row, link;  // row: 0 body, 1 carried; link: a link with these spheres
  int32_t first, count, first_cluster, n_cluster;
  float centre[3], half[3], radius, bound;  // radius: of the largest sphere; bound: of the ball
};

// Constants of the model; fields() in body_impact.hpp names them.
struct BodyConstants {
  double brake_time, brake_stop, step, carry_on;
  double stop_gain[kGenerators], stop_tolerance[kGenerators];
  double offset[kGenerators][2], spread[kGenerators][2];  // for body and carried object
};

struct BodyTables {
  int32_t n_frame, n_row, n_entity, n_step, n_reference, n_fall, n_limb;  // n_fall: steps of a collapse
  const Inertia* inertia;                                                 // per frame
  const JointDrive* drive;                                                // per joint
  const Limb* limb;                                                       // outermost first
  const int32_t* entity;                                                  // per obstacle, -1 for none
  uint64_t looked_at = ~uint64_t(0);  // bit s: whether step s of falling joints is checked for hits
  BodyConstants constants;

  bool looks(int step) const { return step >= 64 || looked_at >> step & 1; }
};

// --- arguments of kernels -------------------------------------------------------------------------------------------

struct States {  // rows [n, n_joint]; qd is null at rest
  const double *q, *qd;
  size_t n;
};

struct Edges {  // straight edges between rows of q0 and q1, sampled at most `step` apart
  const double *q0, *q1;
  size_t n;
  double step;
};

// Inverse kinematics: tool poses, one for each seed.
struct Reach {
  const double *seed, *X_WG;  // [n, n_joint] within the limits, [n, 3, 4]
  const int32_t* free_yaw;    // [n]: whether the tool may turn about its own z axis
  const double* radius;       // [n, 2]: distance [m] and angle [rad] from the pose that are near enough
  size_t n;
  const double* X_LT;  // [4, 4]: the tool in the frame of its link
  int32_t tool_link;
  const double *lower, *upper;  // [n_joint]
  const int32_t* held;          // [n_joint]: whether a joint does not move
  const double* ease;           // [n_joint]: in (0, 1], how far a joint moves compared with others of the same effect
  int iterations, patience;     // largest number; number within which 30 % of the missing twist must vanish
};

struct Slopes {  // a value per state, and its derivatives [n, n_joint]
  double *value, *d_q, *d_qd;
};

// Where the tail of a hit's probability is cut: from `far` spreads on, where the probability is `least`. Negative `far`
// disables the hit.
struct Tail {
  double far, least;
};

struct BodyHarm {  // weights of failure modes [mode, row], severities [row, entity]
  const double *weight, *severity;
  const Tail* tail;  // [generator, row, entity]; null for the tails of the model
};

// The kernels of one instruction set. severity is [n_component, n_entity]; the cost of edges is [n, 2]: length and
// integral of the impact over length.
struct Kernels {
  int lanes;
  void (*link_poses)(const Tables&, const States&, double* X_WL);
  void (*free_states)(const Tables&, const States&, double margin, uint8_t* free);
  void (*free_edges)(const Tables&, const Edges&, double margin, uint8_t* free);
  // Infinite, and without a gradient, where the clearance is at least `far`.
  void (*clearance)(const Tables&, const States&, double far, double* clearance, double* gradient);
  void (*interaction)(const Tables&, const States&, double* probability);
  // Final configuration of each seed [n, n_joint], and its remaining twist to the pose [n, 6].
  void (*reach)(const Tables&, const Reach&, double* q, double* missing);
  void (*impact)(const Tables&, const double* severity, const States&, double* impact);
  void (*edge_costs)(const Tables&, const double* severity, const Edges&, double* cost);
  // The drop and spill models; severity and probability are [kDropRows, n_entity].
  void (*drop)(const Tables&, const DropTables&, const States&, double* probability);
  // Inputs of the network for each surface, and the P that it corrects [n_surface, kNetworkInputs + 1].
  void (*drop_sights)(const Tables&, const DropTables&, const States&, double* sights);
  void (*drop_impact)(const Tables&, const DropTables&, const double* severity, const States&, double* impact);
  void (*drop_gradient)(const Tables&, const DropTables&, const double* severity, const States&, const Slopes&);
  void (*drop_edge_costs)(const Tables&, const DropTables&, const double* severity, const double* pace, const Edges&,
                          double* cost);
  // The drop model in single precision and with shorter tails; error about 1e-5 of the largest severity.
  void (*rough_drop_impact)(const Tables&, const DropTables&, const double* severity, const States&, double* impact);
  void (*rough_drop_gradient)(const Tables&, const DropTables&, const double* severity, const States&, const Slopes&);
  // The body model; ahead is null or [n, n_reference, n_joint].
  void (*body)(const Tables&, const BodyTables&, const States&, const double* ahead, double* distance);
  void (*body_impact)(const Tables&, const BodyTables&, const BodyHarm&, const States&, double* impact);
  void (*body_gradient)(const Tables&, const BodyTables&, const BodyHarm&, const States&, const Slopes&);
  void (*body_dynamics)(const Tables&, const BodyTables&, const States&, double* mass_matrix, double* gravity);
  // Probability that a dropped object or a collapsing arm hits moving entities, P [n, n_entity]: at times t or, if t is
  // null, anywhere along the entities' paths. If severities are given, P is 0 for entities without severity. Gradients
  // are of the sum of P S at times t.
  void (*moving_drop)(const Tables&, const DropTables&, const MovingPaths&, const MovingPlaces&, const double* severity,
                      const States&, const double* t, double* probability);
  void (*moving_drop_gradient)(const Tables&, const DropTables&, const MovingPaths&, const MovingPlaces&,
                               const double* severity, const States&, const double* t, const MovingSlopes&);
  void (*moving_arm)(const Tables&, const MovingPaths&, const double* severity, const States&, const double* t,
                     double* probability);
  void (*moving_arm_gradient)(const Tables&, const MovingPaths&, const double* severity, const States&, const double* t,
                              const MovingSlopes&);
  // Gap to the nearest moving entity, infinite unless below `wanted`; d_q and d_t are null or receive derivatives.
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
