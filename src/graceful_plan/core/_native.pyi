"""Types of the native core; `kernels.py` and the native planners wrap it.

Input arrays of other types or layouts than declared are copied. The caller owns returned arrays.
"""

from collections.abc import Callable, Sequence
from enum import Enum
from typing import TypedDict, final

import numpy as np
from numpy.typing import NDArray

Reals = NDArray[np.float64]
Integers = NDArray[np.int32]

def lever() -> float: ...
def instruction_sets() -> list[str]: ...
def capacity() -> dict[str, int]: ...
def drop_constants() -> list[str]: ...
def spill_constants() -> list[str]: ...
def ball_cover(
    *, points: Reals, reach: Reals, depth: Reals, order: Integers, first: int, candidates: int
) -> Integers: ...
def heights(*, points: Reals, planes: Reals) -> tuple[Reals, Integers]: ...

@final
class Core:
    """The tables of a scene, see `arrays.py`; configurations q are rows [n, nq]."""

    def __init__(
        self,
        *,
        parent: Integers,
        joint: Integers,
        slide: Integers,
        X_PL: Reals,
        n_joint: int,
        sphere_link: Integers,
        sphere: Reals,
        bound: Reals,
        self_pair: Integers,
        self_slack: Reals,
        obstacle_kind: Integers,
        obstacle_pose: Reals,
        obstacle_size: Reals,
        obstacle_bound: Reals,
        ignores: NDArray[np.uint64],
        hull_start: Integers,
        triangles: Reals,
        part_component: Integers,
        part_link: Integers,
        part_box: Reals,
        target_entity: Integers,
        target_box: Reals,
        n_component: int,
        n_entity: int,
        tool_link: int,
        tool_position: Reals,
        keep: Reals,
        cone_link: Integers,
        cone_axis: Reals,
        cone_direction: Reals,
        cone_angle: Reals,
        room_link: Integers,
        room_point: Reals,
        room_rotation: Reals,
        room_position: Reals,
        room_lower: Reals,
        room_upper: Reals,
        isa: str,
    ) -> None: ...
    @property
    def isa(self) -> str: ...
    @property
    def lanes(self) -> int: ...
    def link_poses(self, q: Reals) -> Reals: ...
    def free_states(self, q: Reals, margin: float) -> NDArray[np.bool_]: ...
    def free_edges(self, q0: Reals, q1: Reals, step: float, margin: float) -> NDArray[np.bool_]: ...
    def projected(self, q: Reals, lower: Reals, upper: Reals, clearance: float) -> Reals: ...
    def clearance(self, q: Reals) -> Reals: ...
    def clearance_gradient(self, q: Reals) -> tuple[Reals, Reals]: ...
    def interaction(self, q: Reals) -> Reals: ...
    def reach(
        self,
        *,
        seed: Reals,
        X_WG: Reals,
        free_yaw: Integers,
        radius: Reals,
        X_LT: Reals,
        lower: Reals,
        upper: Reals,
        held: Integers,
        ease: Reals,
        iterations: int,
        patience: int,
    ) -> tuple[Reals, Reals]: ...
    def elementary(self, x: Reals) -> tuple[Reals, Reals]: ...

@final
class DropModel:
    def __init__(
        self,
        *,
        core: Core,
        link: int,
        centre: Reals,
        part_shape: Integers,
        part_offset: Reals,
        part_rotation: Reals,
        part_half: Reals,
        main: int,
        size: float,
        target_entity: Integers,
        target: Reals,
        level_start: Integers,
        n_entity: int,
        speed: Reals,
        constants: dict[str, float],
    ) -> None: ...
    def add_contents(
        self,
        *,
        mouth: Reals,
        axis: Reals,
        container: dict[str, float],
        stands: Integers,
        visible: Reals,
        constants: list[dict[str, float]],
    ) -> None: ...
    def add_stop(self, *, deceleration: Reals, constants: dict[str, float], places: dict[str, float]) -> None: ...
    def add_loss(self, *, strength: Reals, sharpness: float, shift: Reals, weight: Reals) -> None: ...
    def add_damage(self, *, entity: Reals, loss: float) -> None: ...
    def add_network(self, hidden: int, bound: float, weights: Reals) -> None: ...
    def sights(self, q: Reals, qd: Reals) -> Reals: ...
    def probability(self, q: Reals, qd: Reals) -> Reals: ...
    def impact(self, severity: Reals, q: Reals, qd: Reals) -> Reals: ...
    def gradient(self, severity: Reals, q: Reals, qd: Reals, rough: bool = False) -> tuple[Reals, Reals, Reals]: ...

@final
class BodyModel:
    def __init__(
        self,
        *,
        core: Core,
        inertia: Reals,
        drive: Reals,
        row: Integers,
        entity: Integers,
        n_row: int,
        n_entity: int,
        n_step: int,
        constants: dict[str, float],
    ) -> None: ...
    def distances(self, q: Reals, qd: Reals, ahead: Reals | None = None) -> Reals: ...
    def impact(self, weight: Reals, severity: Reals, q: Reals, qd: Reals) -> Reals: ...
    def gradient(self, weight: Reals, severity: Reals, q: Reals, qd: Reals) -> tuple[Reals, Reals, Reals]: ...
    def dynamics(self, q: Reals) -> tuple[Reals, Reals]: ...

class Impact:
    """An impact model with severities; abstract, without a constructor."""

    def states(self, q: Reals) -> Reals: ...
    def moving_states(self, q: Reals, qd: Reals) -> Reals: ...
    def state_slopes(self, q: Reals, qd: Reals, rough: bool = False) -> tuple[Reals, Reals, Reals]: ...
    def edges(self, q0: Reals, q1: Reals, step: float, rough: bool = False) -> Reals: ...
    def edge_gradients(self, q0: Reals, q1: Reals, step: float) -> tuple[Reals, Reals, Reals] | None: ...

@final
class BoxOverlapImpact(Impact):
    def __init__(self, core: Core, severity: Reals) -> None: ...

@final
class DropImpact(Impact):
    def __init__(self, model: DropModel, severity: Reals, slow: float, fast: float) -> None: ...

@final
class SumImpact(Impact):
    def __init__(self, first: Impact, second: Impact) -> None: ...

@final
class Measure(Enum):
    time = ...
    length = ...
    points = ...

@final
class OwnCost(Impact):
    def __init__(
        self,
        core: Core,
        *,
        measure: Measure,
        speed: Reals,
        states: Callable[[Reals], Reals],
        slopes: Callable[[Reals, Reals], tuple[Reals, ...]],
        edges: Callable[[Reals, Reals], Reals],
        edge_slopes: Callable[[Reals, Reals, float], tuple[Reals, ...]] | None = None,
        motion: Callable[[Reals, Reals], tuple[Reals, ...]] | None = None,
    ) -> None: ...

@final
class ClearanceCost(Impact):
    def __init__(self, core: Core, seen: Core, distance: float) -> None: ...

@final
class JointCost(Impact):
    def __init__(self, core: Core, centre: Reals, scale: Reals) -> None: ...

@final
class EnergyCost(Impact):
    def __init__(self, core: Core, inertia: Reals, limit: Reals) -> None: ...

@final
class PoseCost(Impact):
    def __init__(
        self,
        core: Core,
        *,
        link: int,
        tool: Reals,
        position: Reals,
        turn: Reals,
        full: float,
        distance: float,
        angle: float,
    ) -> None: ...

@final
class ManipulabilityCost(Impact):
    def __init__(self, core: Core, *, link: int, tool: Reals, chain: Integers, least: float) -> None: ...

@final
class ScaledImpact(Impact):
    def __init__(self, model: Impact, factor: float) -> None: ...

@final
class TimedImpact(Impact):
    def __init__(self, model: Impact, speed: Reals) -> None: ...

@final
class CoastModel:
    def __init__(
        self,
        core: Core,
        *,
        entity: Integers,
        shape: Reals,
        n_entity: int,
        outline: Reals,
        stops: Reals,
        constants: dict[str, float],
        share: Reals,
        speeds: Reals,
        rates: Reals,
        places: Reals,
        astray: Reals,
        weak: Reals,
        carried: int,
        high_entity: Integers,
        high_shape: Reals,
        height: Reals,
    ) -> None: ...
    def probability(self, q: Reals, qd: Reals) -> Reals: ...

@final
class MovingTable:
    def __init__(
        self,
        *,
        round: Integers,
        half: Reals,
        blur: Reals,
        knot_start: Integers,
        knot: Reals,
        time_start: Integers,
        time: Reals,
    ) -> None: ...

class MovingSource:
    def probability(self, q: Reals, qd: Reals, t: Reals | None) -> Reals: ...

@final
class MovingDrop(MovingSource):
    def __init__(
        self, table: MovingTable, model: DropModel, *, places: Reals, cell: float, protrusion: float
    ) -> None: ...

@final
class MovingArm(MovingSource):
    def __init__(self, table: MovingTable, core: Core) -> None: ...

@final
class MovingCoast(MovingSource):
    def __init__(self, table: MovingTable, model: CoastModel, *, bottom: float, top: float) -> None: ...

@final
class MovingImpact:
    def __init__(self, core: Core, table: MovingTable) -> None: ...
    def add(self, source: MovingSource, severity: Reals) -> None: ...
    def impact(self, q: Reals, qd: Reals, t: Reals | None) -> Reals: ...
    def slopes(self, q: Reals, qd: Reals, t: Reals) -> tuple[Reals, Reals, Reals, Reals]: ...
    def gaps(self, q: Reals, t: Reals, wanted: float) -> tuple[Reals, Reals, Reals]: ...

@final
class CoastImpact(Impact):
    def __init__(
        self, model: CoastModel, rough: CoastModel, severity: Reals, speed: Reals, slow: float, fast: float
    ) -> None: ...

@final
class BodyImpact(Impact):
    def __init__(self, model: BodyModel, weight: Reals, severity: Reals, slow: float, fast: float) -> None: ...

@final
class SpecificForceLimit:
    def __init__(
        self,
        *,
        link: int,
        point: Reals,
        facets: Reals,
        room: Reals,
        gravity: float,
        axis: Reals | None = None,
        angle: float = 0.0,
        length: float = 0.0,
        drag: float = 0.0,
    ) -> None: ...

@final
class TimedCurve:
    @property
    def t(self) -> Reals: ...
    @property
    def q(self) -> Reals: ...
    @property
    def qd(self) -> Reals: ...
    @property
    def qdd(self) -> Reals: ...
    @property
    def speeds(self) -> Reals: ...
    @property
    def excess(self) -> float: ...
    @property
    def failed_limit(self) -> int: ...
    @property
    def failed_point(self) -> int: ...

def spline(controls: Reals, u: Reals) -> Reals: ...
def point_derivatives(core: Core, *, link: int, point: Reals, q: Reals, slope: Reals, bend: Reals) -> Reals: ...
def excess(*, t: Reals, q: Reals, qd: Reals, qdd: Reals, velocity: Reals, acceleration: Reals) -> float: ...
def travelled(
    *, step: Reals, q: Reals, slope: Reals, bend: Reals, speeds: Reals, velocity: Reals, acceleration: Reals
) -> TimedCurve: ...
def fastest(
    *,
    step: Reals,
    q: Reals,
    slope: Reals,
    bend: Reals,
    stop: NDArray[np.bool_],
    velocity: Reals,
    acceleration: Reals,
    limit: Reals | None = None,
    core: Core | None = None,
    levels: Sequence[Sequence[SpecificForceLimit]] = (),
    speed: float = 1.0,
    start: float | None = None,
    end: float | None = None,
) -> TimedCurve: ...

@final
class GraphSearch:
    def __init__(self, n: int, tail: Integers, head: Integers) -> None: ...
    def cheapest(self, cost: Reals, start: int, goals: Integers) -> tuple[Integers, float]: ...
    def front(
        self, cost: Reals, start: int, goals: Integers, epsilon: float, seconds: float
    ) -> tuple[list[Integers], Reals, bool]: ...

class Space:
    """The space that a planner plans in; abstract, without a constructor."""

@final
class SceneSpace(Space):
    def __init__(
        self,
        *,
        core: Core,
        impact: Impact,
        lower: Reals,
        upper: Reals,
        w: float,
        check_step: float,
        fine_step: float,
        cost_step: float,
        margin: float,
        holds: Callable[[Reals], NDArray[np.bool_]] | None = None,
        clearance: Callable[[Reals], tuple[Reals, Reals]] | None = None,
        projects: bool = True,
        still: Impact | None = None,
        moving: MovingImpact | None = None,
        keeps_off: bool = False,
    ) -> None: ...

@final
class CallbackSpace(Space):
    def __init__(
        self,
        *,
        edges_free: Callable[[Reals, Reals], NDArray[np.bool_]],
        edge_costs: Callable[[Reals, Reals], Reals],
        state_costs: Callable[[Reals], Reals],
        lower: Reals,
        upper: Reals,
        w: float,
        motion_is_length: bool,
        core: Core | None = None,
        margin: float = 0.0,
    ) -> None: ...

@final
class Connect:
    def __init__(
        self, space: Space, *, start: Reals, goals: Reals, range: float, max_nodes: int, seed: int
    ) -> None: ...
    def run(self, iterations: int, seconds: float) -> tuple[bool, int]: ...
    @property
    def path(self) -> Reals: ...

@final
class Drive:
    def __init__(
        self, space: Space, *, start: Reals, goals: Reals, cell: float, reverse: bool, max_nodes: int
    ) -> None: ...
    def begin(self, weight: float) -> None: ...
    def run(self, iterations: int, seconds: float) -> tuple[bool, int]: ...
    @property
    def over(self) -> bool: ...
    @property
    def path(self) -> Reals: ...

@final
class Descent:
    def __init__(self, space: Space, path: Reals, pieces: int, step: float) -> None: ...
    def run(self, steps: int) -> int: ...
    def harden(self) -> None: ...
    @property
    def path(self) -> Reals: ...
    @property
    def value(self) -> float: ...
    @property
    def energy(self) -> float: ...

@final
class Rolling:
    def __init__(
        self,
        *,
        speed: float,
        turning: float,
        acceleration: float,
        turning_acceleration: float,
        across: float,
        rim: float,
        lever: float,
        forward: bool = True,
        before: float,
        after: float,
        turns_before: bool = False,
        turns_after: bool = False,
        holds_arm: bool = False,
    ) -> None: ...

@final
class MotionDescent:
    def __init__(
        self,
        space: Space,
        *,
        path: Reals,
        velocity: Reals,
        acceleration: Reals,
        controls: int,
        density: int,
        rough: bool = False,
        time_price: float,
        push: float = 1.0,
        tolerance: float = 1e-4,
        tight_start: float = 0.0,
        tight_end: float = 0.0,
        felt: Sequence[SpecificForceLimit] = (),
        fitted: bool = False,
        slosh: bool = True,
        points: float = 1.0,
        rolling: Rolling | None = None,
        leaving: Reals | None = None,
        least_leg: float = 0.0,
        arriving: Reals | None = None,
        least_last_leg: float = 0.0,
    ) -> None: ...
    def run(self, steps: int, seconds: float) -> int: ...
    def harden(self) -> None: ...
    @property
    def controls(self) -> Reals: ...
    @property
    def inner(self) -> Reals: ...
    def energy(self, controls: Reals) -> tuple[float, Reals]: ...
    @property
    def value(self) -> float: ...
    @property
    def duration(self) -> float: ...
    @property
    def gap(self) -> float: ...
    @property
    def speed_room(self) -> float: ...

@final
class Anytime:
    def __init__(
        self,
        space: Space,
        *,
        start: Reals,
        goals: Reals,
        range: float,
        max_nodes: int,
        spacing: float,
        challengers: int,
        seed: int,
        descents: bool,
        scouts: bool,
    ) -> None: ...
    def admits(self, path: Reals) -> bool: ...
    def adopt(self, path: Reals) -> None: ...
    def suggest(self, path: Reals) -> None: ...
    @property
    def total(self) -> float: ...
    def run(self, iterations: int, seconds: float) -> tuple[bool, int]: ...
    @property
    def path(self) -> Reals: ...
    @property
    def optimal(self) -> bool: ...

@final
class Steering:
    def __init__(self, *, radius: float, reverse: bool, yaw_length: float, penalty: float) -> None: ...
    def curves(self, start: Reals, goal: Reals) -> tuple[Reals, Reals]: ...
    def along(self, start: Reals, pieces: Reals, s: Reals) -> Reals: ...

@final
class StateLattice:
    def __init__(
        self,
        *,
        distance: NDArray[np.float32],
        resolution: float,
        discs: Reals,
        headings: int,
        steering: Steering,
        margin: float,
        impact: NDArray[np.float32] | None,
        impact_back: NDArray[np.float32] | None,
    ) -> None: ...
    def search(
        self,
        *,
        start: Reals,
        goal: Reals,
        w: float,
        lead: float,
        inflations: Sequence[float],
        shots: int,
        max_expansions: int,
        time_limit: float,
    ) -> LatticeAnswer: ...
    def moves(self) -> list[tuple[int, int, int, int, float, Reals]]: ...
    def chain(self) -> float: ...

class LatticeAnswer(TypedDict):
    status: str
    pieces: Reals
    cost: float
    bound: float
    impact: float
    expansions: int
    first_cost: float
    first_expansions: int

def distance_field(*, blocked: NDArray[np.uint8], resolution: float, outside: bool) -> NDArray[np.float32]: ...

@final
class FloorGrid:
    def __init__(self, *, closed: NDArray[np.uint8], resolution: float, charge: NDArray[np.float32] | None) -> None: ...
    def costs(self, column: int, row: int) -> Reals: ...
    def path(
        self, *, start: NDArray[np.int32], goal: NDArray[np.int32], method: str, time_limit: float
    ) -> GridAnswer: ...
    def straight(self, start: NDArray[np.int32], goal: NDArray[np.int32]) -> float: ...

class GridAnswer(TypedDict):
    found: bool
    stopped: bool
    cost: float
    expansions: int
    cells: NDArray[np.int32]

class TimedAnswer(TypedDict):
    found: bool
    stopped: bool
    cost: float
    expansions: int
    nodes: NDArray[np.int32]

def timed_path(
    *,
    open: NDArray[np.uint8],
    rate: NDArray[np.float32],
    width: float,
    moves: NDArray[np.int32],
    price: Reals,
    shape: Reals,
    velocity: NDArray[np.int32],
    beside: NDArray[np.float32],
    apart: float,
    outline: Reals,
    rules: dict[str, float],
    ticks: int,
    start: NDArray[np.int32],
    goal: NDArray[np.int32],
    ending: Reals,
    late: Callable[[], bool],
) -> TimedAnswer: ...

@final
class DynamicWindow:
    def __init__(
        self,
        *,
        outline: Reals,
        stops: Reals,
        constants: dict[str, float],
        share: Reals,
        speeds: Reals,
        rates: Reals,
        places: Reals,
        astray: Reals,
        weak: Reals,
        limits: dict[str, float],
        settings: dict[str, float],
        n_v: int,
        n_omega: int,
    ) -> None: ...
    def choose(
        self,
        *,
        state: Reals,
        path: Reals,
        entity: Integers,
        shape: Reals,
        velocity: Reals,
        severity: Reals,
        every: bool = False,
    ) -> tuple[float, float, float, float, float, bool, int]: ...
