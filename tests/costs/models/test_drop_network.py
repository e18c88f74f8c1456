"""The network that corrects the drop model: core against NumPy, gradients, bounds on its effect, and its files."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from drop_twin import dropped
from hypothesis import given, settings
from hypothesis import strategies as st

import graceful_plan as gp
from graceful_plan.array_types import Float
from graceful_plan.core.compile import compile_scene
from graceful_plan.core.kernels import Kernels, instruction_sets
from graceful_plan.costs.models.drop.constants import DropSettings
from graceful_plan.costs.models.drop.kernel import ROWS, DropKernel, drop_kernel
from graceful_plan.costs.models.drop.network import LOOKS, STATE_FEATURES, DropNetwork, fade, looks
from graceful_plan.costs.models.drop.tables import SHAPE_CLASSES, drop_tables
from graceful_plan.costs.objective import moving_batch
from graceful_plan.exceptions import FormatError, ShapeError

Array = np.ndarray

SETTINGS = DropSettings.shipped()


def random_network(seed: int = 0, hidden: int = 16, bound: float = 2.0) -> DropNetwork:
    rng = np.random.default_rng(seed)

    def some(*shape: int) -> Array:
        return rng.normal(scale=0.5, size=shape)

    return DropNetwork(
        told=some(hidden, len(STATE_FEATURES)),
        looks=some(hidden, len(LOOKS)),
        shapes=some(len(SHAPE_CLASSES), hidden),
        first_bias=some(hidden),
        second=some(hidden, hidden),
        second_bias=some(hidden),
        last=some(hidden),
        last_bias=some(1),
        bound=bound,
    )


@cache
def over_the_desk() -> gp.Task:
    return gp.load_scene("desk").tasks["put_book_away"]


@pytest.fixture(scope="module")
def task() -> gp.Task:
    return over_the_desk()


def states(task: gp.Task, n: int, seed: int = 0) -> tuple[Array, Array]:
    """Return states over the desk, where entities can be hit."""
    rng = np.random.default_rng(seed)
    q = task.start + rng.uniform(size=(n, 1)) * (task.goal[0] - task.start)
    return q + rng.normal(scale=0.15, size=q.shape), rng.normal(scale=0.4, size=q.shape)


def severities(scene: gp.Scene, seed: int = 0) -> Array:
    rows = np.zeros((len(ROWS), len(scene.entities)))
    rows[0] = np.random.default_rng(seed).uniform(1.0, 5.0, len(scene.entities))
    return rows


def corrected(P: Float[Array, "*batch"], log_factor: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Return probabilities with their odds multiplied by factors, given by their logarithms."""
    factor = np.exp(log_factor * fade(P))
    return P * factor / (1.0 - P + P * factor)


def by_numpy(network: DropNetwork, scene: gp.Scene, q: Array, qd: Array) -> Array:
    tables = drop_tables(scene)
    sights = drop_kernel(scene, SETTINGS).sights(q, qd)
    told, plain = sights[..., :-1], sights[..., -1]
    seen = np.broadcast_to(looks(tables), (*plain.shape, len(LOOKS)))
    shape = np.broadcast_to(np.eye(len(SHAPE_CLASSES))[tables.shape_class], (*plain.shape, len(SHAPE_CLASSES)))
    P = corrected(plain, network.log_factor(told, seen, shape))
    F = dropped(moving_batch(scene, q, qd)).first
    found = np.zeros((2, len(q), len(scene.entities)))
    for k, entity in enumerate(tables.target_entity):
        if entity >= 0:
            found[0, :, entity] = np.maximum(found[0, :, entity], P[:, k])
            found[1, :, entity] += F[:, k]
    return found.max(axis=0)


# --- the kernel -------------------------------------------------------------------------------------------------------


def test_the_core_is_the_network_in_numpy(task: gp.Task) -> None:
    q, qd = states(task, 40)
    network = random_network()
    plain = drop_kernel(task.scene, SETTINGS).probability(q, qd)
    found = drop_kernel(task.scene, SETTINGS, network=network).probability(q, qd)
    np.testing.assert_allclose(found[:, 0], by_numpy(network, task.scene, q, qd), atol=1e-12)
    assert np.abs(found[:, 0] - plain[:, 0]).max() > 0.1  # the network has an effect
    np.testing.assert_array_equal(found[:, 1:], plain[:, 1:])  # contents are unchanged


@pytest.mark.parametrize("isa", instruction_sets())
def test_instruction_sets_agree(task: gp.Task, isa: str) -> None:
    compiled, tables = compile_scene(task.scene), drop_tables(task.scene)
    kernels = Kernels(compiled.robot, compiled.world, compiled.impact_tables, isa=isa)
    constants, network = SETTINGS.of(tables.shape_class), random_network()
    kernel = DropKernel(
        tables, constants, kernels, task.scene.limits.velocity, len(task.scene.entities), network=network
    )
    q, qd = states(task, 9)
    np.testing.assert_allclose(kernel.probability(q, qd)[:, 0], by_numpy(network, task.scene, q, qd), atol=1e-11)


def test_gradients_equal_differences(task: gp.Task) -> None:
    q, qd = states(task, 24, seed=3)
    kernel, severity = drop_kernel(task.scene, SETTINGS, network=random_network(1)), severities(task.scene)
    value, d_q, d_qd = kernel.gradient(q, severity, qd)
    np.testing.assert_allclose(value, kernel.impact(q, severity, qd), rtol=1e-12)
    step = 1e-6
    for slope, which in ((d_q, 0), (d_qd, 1)):
        numeric = np.zeros_like(q)
        for j in range(q.shape[1]):
            ahead, back = [q.copy(), qd.copy()], [q.copy(), qd.copy()]
            ahead[which][:, j] += step
            back[which][:, j] -= step
            difference = kernel.impact(ahead[0], severity, ahead[1]) - kernel.impact(back[0], severity, back[1])
            numeric[:, j] = difference / (2.0 * step)
        error = np.abs(numeric - slope).max(axis=1)
        # Equally likely surfaces, and parts at an edge, have two one-sided slopes.
        assert np.sort(error)[-3] < 1e-5 * max(1.0, np.abs(slope).max())
        assert np.abs(slope).max() > 1.0


def test_the_network_changes_the_gradient(task: gp.Task) -> None:
    q, qd = states(task, 8)
    severity = severities(task.scene)
    plain, own = (
        drop_kernel(task.scene, SETTINGS, network=x).gradient(q, severity, qd) for x in (None, random_network())
    )
    assert np.abs(plain[1] - own[1]).max() > 1.0


def test_single_precision_is_close(task: gp.Task) -> None:
    q, qd = states(task, 32)
    kernel, severity = drop_kernel(task.scene, SETTINGS, network=random_network()), severities(task.scene)
    exact = kernel.gradient(q, severity, qd)
    rough = kernel.native.gradient(kernel.severities(severity), q, qd, True)
    np.testing.assert_allclose(rough[0], exact[0], atol=1e-3)
    np.testing.assert_allclose(rough[1], exact[1], atol=2e-3 * np.abs(exact[1]).max())


def test_planners_are_given_the_same(task: gp.Task) -> None:
    model = gp.FailureMixture(network=random_network())
    cost = gp.ImpactCost(model=model)
    q, qd = states(task, 16)
    kernel = cost.kernel(task.scene, (0.5, 0.8))
    assert kernel is not None
    np.testing.assert_allclose(
        kernel.moving_states(q, qd), cost.state(moving_batch(task.scene, q, qd)), rtol=1e-9, atol=1e-9
    )


# --- laws -------------------------------------------------------------------------------------------------------------


@given(seed=st.integers(0, 10**6), bound=st.floats(0.0, 6.0))
def test_odds_stay_within_the_bound_and_each_state_stands_by_itself(seed: int, bound: float) -> None:
    task = over_the_desk()
    q, qd = states(task, 5, seed)
    network = random_network(seed, bound=bound)
    plain = drop_kernel(task.scene, SETTINGS).probability(q, qd)[:, 0]
    kernel = drop_kernel(task.scene, SETTINGS, network=network)
    P = kernel.probability(q, qd)[:, 0]
    assert np.all((P >= 0.0) & (P <= 1.0))
    inside = (plain > 1e-9) & (plain < 1.0 - 1e-9)
    change = np.log(P[inside] / (1.0 - P[inside])) - np.log(plain[inside] / (1.0 - plain[inside]))
    assert np.all(np.abs(change) <= bound + 1e-6)
    np.testing.assert_allclose(P[plain <= 1e-4], plain[plain <= 1e-4], atol=1e-12)
    alone = np.concatenate([kernel.probability(q[i : i + 1], qd[i : i + 1])[:, 0] for i in range(len(q))])
    np.testing.assert_allclose(P, alone, atol=1e-11)  # error of pruning


def test_a_zero_network_changes_nothing(task: gp.Task) -> None:
    q, qd = states(task, 20)
    silent = replace(random_network(), last=np.zeros(16), last_bias=np.zeros(1))
    a, b = (drop_kernel(task.scene, SETTINGS, network=x).probability(q, qd) for x in (None, silent))
    np.testing.assert_allclose(a, b, atol=1e-15)


def test_corrections_fade_in_without_a_jump() -> None:
    P = np.array([0.0, 1e-4 - 1e-12, 1e-4, 1e-4 + 1e-12, 0.3, 1.0])
    assert fade(P)[:3].tolist() == [0.0, 0.0, 0.0]
    found = corrected(P, np.full(6, 3.0))
    assert found[0] == 0.0 and found[-1] == 1.0
    assert np.abs(np.diff(found[1:4])).max() < 1e-10


def _moved(scene: gp.Scene, yaw: float, shift: tuple[float, float, float]) -> gp.Scene:
    """Return the whole scene, robot included, turned about the vertical and moved."""
    spec = scene.spec.copy()
    turn, c, s = np.array([math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]), math.cos(yaw), math.sin(yaw)
    for one in (x for x in (*spec.worldbody.bodies, *spec.worldbody.frames) if x.frame is None):
        quat = np.zeros(4)
        mujoco.mju_mulQuat(quat, turn, np.array(one.quat))
        x, y, z = one.pos
        one.pos, one.quat = [c * x - s * y + shift[0], s * x + c * y + shift[1], z + shift[2]], quat
    return gp.Scene.build(spec, replace(scene.notes, tasks={}, held=None))


@pytest.mark.parametrize(("yaw", "shift"), [(0.7, (0.0, 0.0, 0.0)), (-2.3, (1.5, -0.4, 0.2))])
def test_nothing_changes_if_all_is_moved_and_turned(
    task: gp.Task, yaw: float, shift: tuple[float, float, float]
) -> None:
    q, qd = states(task, 12)
    moved = _moved(gp.load_scene("desk"), yaw, shift).attach("book")
    before, after = (drop_kernel(scene, SETTINGS).sights(q, qd) for scene in (task.scene, moved))
    tables = [drop_tables(scene) for scene in (task.scene, moved)]
    names = [list(scene.entities) for scene in (task.scene, moved)]
    assert names[0] == names[1] and before.shape == after.shape
    # Rounding may reorder surfaces, so each entity's most likely ones are compared.
    for e in range(len(names[0])):
        mine = [np.flatnonzero(t.target_entity == e) for t in tables]
        most = [x[:, k, -1].max(axis=1) for x, k in zip((before, after), mine, strict=True)]
        np.testing.assert_allclose(most[0], most[1], atol=1e-5)
    likely = before[..., -1] > 1e-3
    np.testing.assert_allclose(before[likely], after[likely], atol=1e-5)


# --- files ------------------------------------------------------------------------------------------------------------


def test_written_files_can_be_read(tmp_path: Path) -> None:
    network = replace(random_network(), about={"drops": 7})
    network.write(tmp_path / "net.npz")
    found = DropNetwork.read(tmp_path / "net.npz")
    assert (found.bound, found.about) == (network.bound, {"drops": 7})
    for name in ("told", "looks", "shapes", "first_bias", "second", "second_bias", "last", "last_bias"):
        np.testing.assert_array_equal(getattr(found, name), getattr(network, name))
    again = pickle.loads(pickle.dumps(found))  # models are sent to other processes
    np.testing.assert_array_equal(again.told, network.told)


def test_the_shipped_network_has_a_provenance(task: gp.Task) -> None:
    network = DropNetwork.shipped()
    assert network.about["drops"] > 1000 and network is DropNetwork.shipped()
    q, qd = states(task, 8)
    plain, own = (gp.FailureMixture(network=x).probability(moving_batch(task.scene, q, qd)) for x in (None, network))
    assert np.abs(plain - own).max() > 1e-3


def _rewritten(file: Path, target: Path, **changes: object) -> Path:
    with np.load(file, allow_pickle=False) as data:
        arrays = {name: data[name] for name in data.files}
    header = json.loads(str(arrays["header"]))
    for name, value in changes.items():
        if name in arrays:
            arrays[name] = np.asarray(value)
        else:
            header[name] = value
    arrays["header"] = np.array(json.dumps(header)) if "header" not in changes else arrays["header"]
    np.savez(target, **arrays)
    return target


@pytest.mark.parametrize(
    "changes",
    [
        {"schema": "something"},
        {"version": 2},
        {"told": ["other", "names"]},
        {"shapes": ["box"]},
        {"bound": 31.0},
        {"bound": float("nan")},
        {"bound": "much"},
        {"bound": None},
        {"last": np.full(16, np.nan)},
        {"last": np.full(16, 1e9)},
        {"last": np.zeros(3)},
        {"last": np.zeros(0)},
        {"last": np.float64(1.0)},
        {"last_bias": np.array(["x"])},
        {"second": np.array([{}], dtype=object)},
        {"header": np.array("{not json")},
        {"header": np.array("[" * 100_000)},
        {"about": 3},
    ],
    ids=str,
)
def test_other_files_are_refused(tmp_path: Path, changes: dict[str, object]) -> None:
    random_network().write(tmp_path / "net.npz")
    broken = _rewritten(tmp_path / "net.npz", tmp_path / "broken.npz", **changes)
    with pytest.raises(FormatError, match="broken"):
        DropNetwork.read(broken)


@settings(max_examples=25)
@given(at=st.floats(0.0, 1.0), flip=st.integers(1, 255), cut=st.booleans())
def test_damaged_files_are_refused_or_harmless(
    tmp_path_factory: pytest.TempPathFactory, at: float, flip: int, cut: bool
) -> None:
    folder = tmp_path_factory.mktemp("net")
    random_network(hidden=2).write(folder / "net.npz")
    data = bytearray((folder / "net.npz").read_bytes())
    where = int(at * (len(data) - 1))
    data = data[:where] if cut else data
    if not cut:
        data[where] ^= flip
    (folder / "damaged.npz").write_bytes(bytes(data))
    try:
        found = DropNetwork.read(folder / "damaged.npz")
    except FormatError:
        return
    assert np.isfinite(found.told).all()  # fields without a checksum


def test_large_files_are_not_unpacked(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "bomb.npz", header=np.zeros(1 << 21))
    with pytest.raises(FormatError, match="holds 16777216 bytes"):
        DropNetwork.read(tmp_path / "bomb.npz")
    (tmp_path / "long.npz").write_bytes(b"\0" * (1 << 21))
    with pytest.raises(FormatError, match="zip"):
        DropNetwork.read(tmp_path / "long.npz")
    with pytest.raises(FormatError, match="nowhere"):
        DropNetwork.read(tmp_path / "nowhere.npz")


def test_arrays_have_to_fit() -> None:
    with pytest.raises(ShapeError, match="second"):
        replace(random_network(), second=np.zeros((3, 3)))
