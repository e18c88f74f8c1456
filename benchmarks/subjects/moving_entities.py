"""Do drops hit those who walk past as often as predicted, and is knowing the time worth anything?"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

import graceful_plan as gp
from benchmarks import report, suite
from failbench.calibrations.skill import Figures, brier, figures
from graceful_plan.costs.models.drop.tables import drop_tables
from graceful_plan.timing.trajectory import State

TITLE = "Moving entities: predicted against simulated hits of those who walk past"
MEASURED = """\
Along a planned motion of every task, the carried object is let go at random times while somebody walks past: a person
(upright cylinder, 0.4 m wide, 1.7 m high), a cat on the floor, or a cat on the table. They walk at 0.5 to 1.5 m/s in
random directions, on straight lines that pass the object at up to 0.4 m, up to 0.5 s before or after the drop, and pass
through furniture as ghosts do: MuJoCo moves them as mocap bodies that only the object collides with. The robot is taken
away at the release; the object leaves with the velocity that it then has plus noise of 0.05 m/s and 1 rad/s, 0.03 s
late. A hit is any contact within 1.5 s. All else stands still.

"at its time" is the model of this library (`costs/models/moving/drops.py`, constants as fitted to drops among things
that stand still: nothing was fitted here). "standing" takes everybody to stay where they are at the release. Skill is
the Brier skill against the share of hits among the same events.
"""
SKILL = 0.4
RATIO = (0.7, 1.4)
_PERSON, _CAT = np.array([0.2, 0.85]), np.array([0.2, 0.1, 0.12])
_KINDS = ("person", "cat on the floor", "cat on the table")
_MODELS = ("at its time", "standing")
_LATE, _NOISE, _SPIN, _HORIZON = 0.03, 0.05, 1.0, 1.5
_REACH, _AGO = 0.4, 0.5
"""Farthest passage beside the object [m], and longest time between passage and drop [s]."""

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class Event:
    """One drop while somebody walks past."""

    task: str
    kind: str
    hit: bool
    predicted: tuple[float, ...]
    """In the order of `_MODELS`."""


def run(options: suite.Options) -> str:
    """Drop things beside those who walk past."""
    tasks = suite.task_names(options)
    jobs = [(task, 12 if options.quick else 120) for task in tasks]
    events = [event for part in suite.spread(drop_all, jobs, options.processes, "moving") for event in part]
    rows = [row for kind in (*_KINDS, "all") for row in _rows(kind, [e for e in events if kind in ("all", e.kind)])]
    header = ("who", "events", "hits", "model", "Brier", "skill", "AUC", "ECE", "predicted / observed")
    return f"{MEASURED}\n{report.targets(_targets(events))}\n{report.table(header, rows)}"


def _targets(events: list[Event]) -> list[report.Target]:
    found = _figures(events, 0)
    low, high = RATIO
    return [
        report.Target(
            what="Brier skill at its time, all",
            wanted=f"at least {SKILL}",
            measured=report.quantity(found.brier_skill),
            met=found.brier_skill >= SKILL,
        ),
        report.Target(
            what="predicted over observed hits, all",
            wanted=f"{low} to {high}",
            measured=report.quantity(found.ratio),
            met=low <= found.ratio <= high,
        ),
    ]


def _rows(kind: str, events: list[Event]) -> Iterator[tuple[object, ...]]:
    hits = [event.hit for event in events]
    for i, model in enumerate(_MODELS):
        found, score = _figures(events, i), brier([event.predicted[i] for event in events], hits)
        numbers = (found.brier_skill, found.auc, found.calibration_error, found.ratio)
        yield kind, len(events), sum(hits), model, f"{score:.4f}", *(report.quantity(number) for number in numbers)


def _figures(events: list[Event], model: int) -> Figures:
    return figures([event.predicted[model] for event in events], [event.hit for event in events])


# --- drops ------------------------------------------------------------------------------------------------------------


def drop_all(job: tuple[str, int]) -> list[Event]:
    """Drop the object of a task many times while somebody walks past."""
    name, count = job
    task, rng = suite.task(name), np.random.default_rng(0)
    result = gp.plan(task.start, task.goal, task.scene, w=0.0, iterations=200, seed=0)
    if result.trajectory is None:
        return []
    table = _table_height(task.scene)
    return [_drop(name, task.scene, result.trajectory, table, _KINDS[i % len(_KINDS)], rng) for i in range(count)]


def _table_height(scene: gp.Scene) -> float:
    """Height of the largest surface above the floor [m]."""
    tables = drop_tables(scene)
    raised = tables.target_height[:, 1] > 0.2
    return float(tables.target_height[raised, 1][np.argmax(tables.target_half[raised].prod(axis=1))])


def _drop(
    name: str, scene: gp.Scene, trajectory: gp.Trajectory, table: float, kind: str, rng: np.random.Generator
) -> Event:
    t = rng.uniform(trajectory.t[0], trajectory.t[-1])
    state = trajectory.at(t)
    batch = _batch(scene, state, None)
    walker = _walker(kind, batch.object_poses[0, :2, 3], t, table, rng)
    models = (walker, gp.MovingEntity("walker", "adult", size=walker.size, t=np.zeros(1), yaw=walker.at(t).yaw[None],
              position=walker.at(t).position[None]))  # fmt: skip
    predicted = tuple(_predicted(scene, entity, state, np.array([t])) for entity in models)
    return Event(task=name, kind=kind, hit=simulate(scene, trajectory, t, walker, rng), predicted=predicted)


def _batch(scene: gp.Scene, state: State, time: Array | None) -> gp.StateBatch:
    speed = np.linalg.norm(state.qd)
    direction = state.qd / max(speed, 1e-12)
    return gp.StateBatch(scene, state.q[None], direction[None], np.array([speed]), time)


def _predicted(scene: gp.Scene, entity: gp.MovingEntity, state: State, time: Array | None) -> float:
    moving = scene.with_moving(entity)
    row = list(moving.components).index("carried")
    P = gp.ImpactCost(model="footprint").probability(_batch(moving, state, time))
    return float(P[0, row, -1])


def _walker(kind: str, place: Array, t: float, table: float, rng: np.random.Generator) -> gp.MovingEntity:
    """Return somebody who passes near a place at about a time."""
    size = _PERSON if kind == "person" else _CAT
    heading, speed, passes = rng.uniform(-np.pi, np.pi), rng.uniform(0.5, 1.5), t + rng.uniform(-_AGO, _AGO)
    along = np.array([np.cos(heading), np.sin(heading)])
    nearest = place + rng.uniform(-_REACH, _REACH) * np.array([-along[1], along[0]])
    times = passes + np.array([-3.0, 3.0])
    height = size[-1] + (table + 0.005 if kind == "cat on the table" else 0.0)
    position = np.column_stack([nearest + speed * (times - passes)[:, None] * along, np.full(2, height)])
    return gp.MovingEntity("walker", "adult", size=size, t=times, position=position, yaw=np.full(2, heading))


def simulate(
    scene: gp.Scene, trajectory: gp.Trajectory, t: float, walker: gp.MovingEntity, rng: np.random.Generator
) -> bool:
    """Let go of the object in MuJoCo at time t, a little late, and tell whether it touches the walker."""
    model = _model(scene, walker)
    data, state = mujoco.MjData(model), trajectory.at(t + _LATE)
    held = scene.data_at(state.q)
    data.qpos[:] = held.qpos
    assert scene.carried is not None
    body = model.body(scene.carried.body).id
    joint = model.jnt_dofadr[model.body_jntadr[body]]
    velocity, spin = _object_velocity(scene, state, body)
    data.qvel[joint : joint + 3] = velocity + rng.normal(0.0, _NOISE, 3)
    R = held.xmat[body].reshape(3, 3)
    data.qvel[joint + 3 : joint + 6] = R.T @ (spin + rng.normal(0.0, _SPIN, 3))
    target, object_ = (
        model.geom("walker").id,
        set(np.flatnonzero(model.body_rootid[model.geom_bodyid] == body).tolist()),
    )
    while data.time < _HORIZON:
        place = walker.at(t + _LATE + data.time)
        data.mocap_pos[0] = place.position
        data.mocap_quat[0] = [np.cos(place.yaw / 2), 0.0, 0.0, np.sin(place.yaw / 2)]
        mujoco.mj_step(model, data)
        if any({*pair} - {target} <= object_ and target in pair for pair in data.contact.geom.tolist()):
            return True
    return False


def _model(scene: gp.Scene, walker: gp.MovingEntity) -> mujoco.MjModel:
    """Return the scene with the walker and with a robot that nothing collides with."""
    spec = scene.spec.copy()
    kind = mujoco.mjtGeom.mjGEOM_CYLINDER if walker.is_round else mujoco.mjtGeom.mjGEOM_BOX
    size = [*walker.size, *[0.0] * (3 - len(walker.size))]
    spec.worldbody.add_body(name="walker", mocap=True).add_geom(name="walker", type=kind, size=size)
    model = spec.compile()
    for geom in range(model.ngeom):
        if int(model.geom_bodyid[geom]) in scene.robot_bodies:
            model.geom_contype[geom] = model.geom_conaffinity[geom] = 0
    for body in scene.robot_bodies:
        model.body_gravcomp[body] = 1.0
    return model


def _object_velocity(scene: gp.Scene, state: State, body: int) -> tuple[Array, Array]:
    """Velocity of the origin of the object's body and its angular velocity in W, by finite differences."""
    dt = 1e-4
    before, after = (scene.data_at(state.q + sign * dt * state.qd) for sign in (-0.5, 0.5))
    turn = after.xmat[body].reshape(3, 3) @ before.xmat[body].reshape(3, 3).T
    spin = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return (after.xpos[body] - before.xpos[body]) / dt, spin / dt
