"""Typed Python interface to the native kernels: shapes, units and checks.

All functions take configurations q with any leading batch axes. Inputs and outputs are float64; inside, collision
runs in float32 lanes and impact in float64 lanes. Kernels hold no state and release the GIL.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from graceful_plan.array_types import Array, Bool, Float
from graceful_plan.core import _native
from graceful_plan.core.arrays import BoundArrays, ImpactArrays, RobotArrays, WorldArrays
from graceful_plan.exceptions import SettingError, ShapeError, UnsupportedError
from graceful_plan.path import finite_array
from graceful_plan.setting_checks import finite

CHECK_STEP = 1.0 / 32.0
"""Largest joint-space distance between checked configurations of an edge [rad]."""
FINE_STEP = 1.0 / 256.0
"""Largest distance between checked configurations of edges of a path [rad]; an arm moves at most 5 mm between them."""
CAPACITY: dict[str, int] = dict(_native.capacity())
"""Largest numbers of joints, links, spheres, parts and entities that the kernels hold."""
LEVER: float = _native.lever()
"""Clearance per radian of an angular bound [m/rad], so that one margin applies to distances and angles."""
MAX_SAMPLES = 1_000_000
"""Largest number of configurations that an edge is sampled at."""
MAX_POSITION = 1000.0
"""Largest joint position that kernels take [rad or m]; single precision is too coarse beyond."""
PROJECTED = 0.003
"""Clearance of projected configurations beyond the margin [m]; a straight edge between two may lose this much."""
COST_STEP = 0.015
"""Largest joint-space distance between samples of the impact along an edge [rad]."""


def instruction_sets() -> tuple[str, ...]:
    """Return the names of the instruction sets that this machine supports, best first."""
    return tuple(_native.instruction_sets())


def _integers(values: Array) -> Array:
    return np.ascontiguousarray(values, dtype=np.int32)


def reals(values: ArrayLike) -> Array:
    """Return numbers as a contiguous float64 array, as the core takes them."""
    return np.ascontiguousarray(values, dtype=np.float64)


class Kernels:
    """Batched kinematics, collision and impact of one scene.

    Args:
        robot: Tables of the robot.
        world: Tables of the obstacles.
        impact_tables: Components and entities.
        isa: Instruction set, "auto" for the best; see `instruction_sets`.
        bounds: Bounds beyond collision. They count in "free" and "clearance", too; an angle [rad] counts as `LEVER`
            metres.
    """

    def __init__(
        self,
        robot: RobotArrays,
        world: WorldArrays,
        impact_tables: ImpactArrays,
        isa: str = "auto",
        bounds: BoundArrays | None = None,
    ) -> None:
        if isa != "auto" and isa not in instruction_sets():
            raise SettingError("isa", isa, f"'auto' or one of {', '.join(instruction_sets())}")
        self.robot, self.world, self.impact_tables = robot, world, impact_tables
        bounds = BoundArrays.none(len(world.kind)) if bounds is None else bounds
        self.nq = len(robot.lower)
        try:
            self.core = _native.Core(
                parent=_integers(robot.parent),
                joint=_integers(robot.joint),
                slide=_integers(robot.slide),
                X_PL=reals(robot.X_PL),
                n_joint=self.nq,
                sphere_link=_integers(robot.sphere_link),
                sphere=reals(robot.sphere),
                bound=reals(robot.bound),
                self_pair=_integers(robot.self_pair),
                self_slack=reals(robot.self_slack),
                obstacle_kind=_integers(world.kind),
                obstacle_pose=reals(world.pose),
                obstacle_size=reals(world.size),
                obstacle_bound=reals(world.bound),
                ignores=np.ascontiguousarray(world.ignores, dtype=np.uint64),
                hull_start=_integers(world.hull_start),
                triangles=reals(world.triangles),
                part_component=_integers(impact_tables.part_component),
                part_link=_integers(impact_tables.part_link),
                part_box=reals(impact_tables.part_box),
                target_entity=_integers(impact_tables.target_entity),
                target_box=reals(impact_tables.target_box),
                n_component=impact_tables.severity.shape[0],
                n_entity=impact_tables.severity.shape[1],
                tool_link=robot.tool_link,
                tool_position=reals(robot.X_LT[:3, 3]),
                keep=reals(bounds.keep),
                cone_link=_integers(bounds.cone_link),
                cone_axis=reals(bounds.cone_axis),
                cone_direction=reals(bounds.cone_direction),
                cone_angle=reals(bounds.cone_angle),
                room_link=_integers(bounds.room_link),
                room_point=reals(bounds.room_point),
                room_rotation=reals(bounds.room_rotation),
                room_position=reals(bounds.room_position),
                room_lower=reals(bounds.room_lower),
                room_upper=reals(bounds.room_upper),
                isa=isa,
            )
        except ValueError as error:
            raise UnsupportedError(f"the kernels do not take the scene: {error}") from None

    @property
    def isa(self) -> str:
        """Instruction set in use."""
        return self.core.isa

    def link_poses(self, q: ArrayLike) -> Float[Array, "*batch link 4 4"]:
        """Return the pose of every link in W [m]."""
        flat, batch = self.rows("q", q)
        return self.core.link_poses(flat).reshape(*batch, len(self.robot.parent), 4, 4)

    def tool_pose(self, q: ArrayLike) -> Float[Array, "*batch 4 4"]:
        """Return the pose of the tool in W [m]."""
        return self.link_poses(q)[..., self.robot.tool_link, :, :] @ self.robot.X_LT

    def reach(
        self,
        seeds: Float[Array, "n nq"],
        X_WG: Float[Array, "n 4 4"],
        free_yaw: Bool[Array, " n"],
        *,
        iterations: int,
        patience: int,
        held: slice = slice(0),
        radius: Float[Array, "n 2"] | None = None,
        ease: Float[Array, " nq"] | None = None,
    ) -> tuple[Float[Array, "n nq"], Float[Array, "n 6"]]:
        """Move each seed towards its tool pose by damped least squares, within the position limits.

        A seed stops at its pose, after all iterations, or when it makes too little progress. Seeds do not affect each
        other.

        Args:
            seeds: Initial configurations [rad or m].
            X_WG: Tool pose for each seed.
            free_yaw: Whether the tool may turn about its own z axis at that pose.
            iterations: Largest number of iterations for each seed.
            patience: Number of iterations within which at least 30 % of the error must vanish.
            held: Joints that do not move.
            radius: Distance [m] and angle [rad] from the pose that are near enough, for each seed; 0 by default.
            ease: In (0, 1], how far a joint moves compared with others of the same effect; 1 by default.

        Returns:
            The final configurations, and the twist that takes the tool from there to the pose, or to the nearest one
            that is near enough: translation [m] and rotation vector [rad], both in W.
        """
        kept = np.zeros(self.nq, dtype=np.int32)
        kept[held] = 1
        robot = self.robot
        return self.core.reach(
            seed=self.rows("seeds", seeds)[0],
            X_WG=reals(X_WG[:, :3]),
            free_yaw=_integers(free_yaw),
            radius=reals(np.zeros((len(X_WG), 2)) if radius is None else radius),
            X_LT=reals(robot.X_LT),
            lower=reals(robot.lower),
            upper=reals(robot.upper),
            held=kept,
            ease=reals(np.ones(self.nq) if ease is None else ease),
            iterations=iterations,
            patience=patience,
        )

    def free(self, q: ArrayLike, margin: float = 0.0) -> Bool[Array, "*batch"]:
        """Return whether configurations keep at least `margin` [m] of clearance; never optimistic."""
        flat, batch = self.rows("q", q)
        _check_margin(margin)
        return self.core.free_states(flat, margin).reshape(batch)

    def edges_free(
        self, q0: ArrayLike, q1: ArrayLike, step: float = CHECK_STEP, margin: float = 0.0
    ) -> Bool[Array, "*batch"]:
        """Return whether straight edges are free at configurations at most `step` [rad] apart, ends included."""
        first, second, batch = self.edge_rows(q0, q1, step)
        _check_margin(margin)
        return self.core.free_edges(first, second, step, margin).reshape(batch)

    def projected(self, q: ArrayLike, margin: float = 0.0) -> Float[Array, "*batch nq"]:
        """Move configurations to where bounds hold by `margin` [m] plus `PROJECTED`, as far as position limits allow.

        Configurations that satisfy this already do not change; without bounds none does. Obstacles are ignored.
        """
        flat, batch = self.rows("q", q)
        _check_margin(margin)
        lower, upper = reals(self.robot.lower), reals(self.robot.upper)
        return self.core.projected(flat, lower, upper, margin + PROJECTED).reshape(*batch, self.nq)

    def clearance(self, q: ArrayLike) -> Float[Array, "*batch"]:
        """Return the signed clearance of the spheres [m], positive outside; infinite if there is nothing to hit.

        Where positive, it is a lower bound of the true clearance.
        """
        flat, batch = self.rows("q", q)
        return self.core.clearance(flat).reshape(batch)

    def clearance_gradient(self, q: ArrayLike) -> tuple[Float[Array, "*batch"], Float[Array, "*batch nq"]]:
        """Return the signed clearance [m] and its gradient [m/rad], that of one pair if several are nearest."""
        flat, batch = self.rows("q", q)
        clearance, gradient = self.core.clearance_gradient(flat)
        return clearance.reshape(batch), gradient.reshape(*batch, self.nq)

    def interaction(self, q: ArrayLike) -> Float[Array, "*batch component entity"]:
        """Return the probability that each component hits each entity given a failure at q, by Algorithm 1."""
        flat, batch = self.rows("q", q)
        return self.core.interaction(flat).reshape(*batch, *self.impact_tables.severity.shape)

    def overlap(self, severity: Float[Array, "component entity"]) -> ImpactKernel:
        """Return the impact model of Algorithm 1 with these severities."""
        if np.shape(severity) != self.impact_tables.severity.shape:
            raise ShapeError("severity", np.shape(severity), str(self.impact_tables.severity.shape))
        return ImpactKernel(self, _native.BoxOverlapImpact(self.core, reals(finite_array("severity", severity))))

    def impact(self, q: ArrayLike, severity: Float[Array, "component entity"]) -> Float[Array, "*batch"]:
        """Return the expected severity given a failure at q by Algorithm 1: the sum of P S."""
        return self.overlap(severity).states(q)

    def edge_costs(
        self, q0: ArrayLike, q1: ArrayLike, severity: Float[Array, "component entity"], step: float = COST_STEP
    ) -> Float[Array, "*batch 2"]:
        """Return the length [rad] of each straight edge and the integral of Algorithm 1's impact over its length."""
        return self.overlap(severity).edges(q0, q1, step)

    def rows(self, name: str, q: ArrayLike) -> tuple[Float[Array, "n nq"], tuple[int, ...]]:
        """Return configurations (or velocities) as rows for the core, and their batch axes."""
        array = self._positions(name, q)
        return reals(array.reshape(-1, self.nq)), array.shape[:-1]

    def edge_rows(self, q0: ArrayLike, q1: ArrayLike, step: float) -> tuple[Array, Array, tuple[int, ...]]:
        """Return the ends of edges as rows for the core, and their batch axes."""
        if not step > 0.0:
            raise SettingError("step", step, "a positive length [rad]")
        first, second = self._positions("q0", q0), self._positions("q1", q1)
        try:
            first, second = np.broadcast_arrays(first, second)
        except ValueError:
            raise ShapeError("q1", second.shape, f"to broadcast with q0 {first.shape}") from None
        longest = float(np.max(np.linalg.norm(second - first, axis=-1), initial=0.0))
        if longest > step * MAX_SAMPLES:
            raise SettingError("step", step, f"at least {longest / MAX_SAMPLES:.3g} for an edge of {longest:.3g} rad")
        return reals(first.reshape(-1, self.nq)), reals(second.reshape(-1, self.nq)), first.shape[:-1]

    def _positions(self, name: str, q: ArrayLike) -> Float[Array, "..."]:
        array = finite_array(name, q, last=self.nq)
        if array.size and np.abs(array).max() > MAX_POSITION:
            raise SettingError(name, float(np.abs(array).max()), f"positions of at most {MAX_POSITION:g} rad or m")
        return array


class ImpactKernel:
    """A native model of the impact with fixed severities, from which native planners compute the cost of edges.

    Args:
        kernels: Kernels of the scene.
        native: The model in the core.
    """

    def __init__(self, kernels: Kernels, native: _native.Impact) -> None:
        self.kernels, self.native = kernels, native

    def __add__(self, other: ImpactKernel) -> ImpactKernel:
        """Return the sum of two models of one scene."""
        return ImpactKernel(self.kernels, _native.SumImpact(self.native, other.native))

    def scaled(self, factor: float) -> ImpactKernel:
        """Return the model with all values multiplied by a factor >= 0."""
        return self if factor == 1.0 else ImpactKernel(self.kernels, _native.ScaledImpact(self.native, factor))

    def timed(self, speed: Float[Array, " nq"]) -> ImpactKernel:
        """Return the model with edges integrated over time, at these joint speeds [rad/s or m/s]."""
        return ImpactKernel(self.kernels, _native.TimedImpact(self.native, reals(speed)))

    def states(self, q: ArrayLike) -> Float[Array, "*batch"]:
        """Return the expected severity given a failure at q, at rest."""
        flat, batch = self.kernels.rows("q", q)
        return self.native.states(flat).reshape(batch)

    def moving_states(self, q: ArrayLike, qd: ArrayLike) -> Float[Array, "*batch"]:
        """Return the expected severity given a failure at q and qd."""
        flat, batch = self.kernels.rows("q", q)
        return self.native.moving_states(flat, self.kernels.rows("qd", qd)[0]).reshape(batch)

    def state_slopes(
        self, q: ArrayLike, qd: ArrayLike, *, rough: bool = False
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch nq"], Float[Array, "*batch nq"]]:
        """Return the expected severity given a failure at q and qd, and its derivatives with respect to q and qd.

        Args:
            q: Configurations.
            qd: Joint velocities.
            rough: Whether the rows are successive states of a motion, for which the model of descents is enough.
        """
        flat, batch = self.kernels.rows("q", q)
        value, d_q, d_qd = self.native.state_slopes(flat, self.kernels.rows("qd", qd)[0], rough)
        return value.reshape(batch), d_q.reshape(*batch, self.kernels.nq), d_qd.reshape(*batch, self.kernels.nq)

    def edges(
        self, q0: ArrayLike, q1: ArrayLike, step: float = COST_STEP, *, rough: bool = False
    ) -> Float[Array, "*batch 2"]:
        """Return each straight edge's length [rad] and its integral of the impact over length or, if timed, time [s].

        Uses the trapezoid rule. For a model that depends on velocity, an edge is travelled as fast as its slowest joint
        allows.

        Args:
            q0: First ends of the edges.
            q1: Second ends of the edges.
            step: Largest distance between samples [rad].
            rough: Whether the coarser model of native searches is enough; for most models there is no difference.
        """
        first, second, batch = self.kernels.edge_rows(q0, q1, step)
        return self.native.edges(first, second, step, rough).reshape(*batch, 2)

    def edge_gradients(
        self, q0: ArrayLike, q1: ArrayLike, step: float = COST_STEP
    ) -> tuple[Float[Array, "*batch 2"], Float[Array, "*batch nq"], Float[Array, "*batch nq"]] | None:
        """Return `edges`, and the derivatives of the integral of the impact with respect to `q0` and `q1`.

        None if the model has no derivatives. At kinks (another joint becomes the slowest, two surfaces are equally
        likely), the derivative is that of one side. For failures of the arm it is approximate: see
        `BodyModel.impact_gradient`.
        """
        first, second, batch = self.kernels.edge_rows(q0, q1, step)
        found = self.native.edge_gradients(first, second, step)
        if found is None:
            return None
        costs, d_q0, d_q1 = found
        return costs.reshape(*batch, 2), d_q0.reshape(*batch, self.kernels.nq), d_q1.reshape(*batch, self.kernels.nq)


def _check_margin(margin: float) -> None:
    finite("margin", margin, "a finite distance [m]")
