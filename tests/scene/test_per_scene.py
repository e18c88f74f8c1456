"""Values cached per scene: computed once for each key, and freed with the scene."""

import copy
import gc
import pickle
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from places import LIBRARY

import graceful_plan as gp
from graceful_plan.core.compile import compile_scene
from graceful_plan.costs.cost import StateBatch
from graceful_plan.judge.exact import first_collision
from graceful_plan.judge.motion_samples import reach
from graceful_plan.scene.loading.file import read_scene
from graceful_plan.scene.per_scene import per_layout, per_scene
from graceful_plan.scene.rules.grip import find_grip


class Kept:
    """An object with a weak reference."""


def fresh(name: str) -> gp.Scene:
    """Load a bundled scene from its file: `load_scene` returns the same scene in all tests."""
    return read_scene(LIBRARY / "scene" / "scenes" / f"{name}.yaml")


def test_a_value_is_made_once_for_each_scene_and_key():
    calls = []

    @per_scene
    def kept(scene, number=0, *, word=""):
        """Return the cached value."""
        calls.append((scene, number, word))
        return Kept()

    one, other = fresh("tabletop"), fresh("tabletop")
    values = [kept(one), kept(one, 1), kept(one, word="a"), kept(other)]
    assert [kept(one), kept(one, 1), kept(one, word="a"), kept(other)] == values
    assert len(set(values)) == len(calls) == 4
    assert (kept.__name__, kept.__doc__) == ("kept", "Return the cached value.")


def test_none_is_a_value_and_an_exception_is_not():
    calls = []

    @per_scene
    def kept(scene, number):
        calls.append(number)
        if number < 0:
            raise ValueError(number)

    scene = fresh("tabletop")
    for number in (1, 1, -1, -1):
        if number < 0:
            with pytest.raises(ValueError, match="-1"):
                kept(scene, number)
        else:
            assert kept(scene, number) is None
    assert calls == [1, -1, -1]


def test_the_oldest_goes_where_there_are_too_many():
    calls = []

    @per_scene(most=2)
    def kept(scene, number):
        calls.append(number)
        return number

    scene, other = fresh("tabletop"), fresh("tabletop")
    assert [kept(scene, number) for number in (1, 2, 1, 3, 2, 1)] == [1, 2, 1, 3, 2, 1]
    assert calls == [1, 2, 3, 1]
    assert kept(other, 1) == 1  # each scene has its own value
    assert kept(scene, 1) == 1
    assert calls == [1, 2, 3, 1, 1]


def test_values_independent_of_obstacles_survive_their_moves():
    calls = []

    @per_layout(most=2)
    def kept(scene, number):
        calls.append(number)
        return number

    scene = fresh("desk").tasks["bring_coffee"].scene
    moved = scene.edit(move={"monitor": [0.6, 0.3, 0.9]})
    assert [kept(scene, 1), kept(moved, 1), kept(moved, 2), kept(scene, 3), kept(moved, 1)] == [1, 1, 2, 3, 1]
    assert calls == [1, 2, 3, 1]
    assert find_grip(moved) is find_grip(scene)


def test_threads_get_the_same_value():
    @per_scene(most=3)
    def kept(scene, number):
        return Kept()

    scene = fresh("tabletop")
    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(lambda _: kept(scene, 1), range(64)))) == 1
        list(pool.map(lambda number: kept(scene, number % 7), range(700)))


def test_values_are_freed_with_the_scene():
    @per_scene
    def kept(scene, number):
        return Kept()

    scene = fresh("tabletop")
    watched = [weakref.ref(kept(scene, number)) for number in range(3)]
    assert all(ref() is not None for ref in watched)
    del scene
    gc.collect()
    assert [ref() for ref in watched] == [None] * 3


def test_nothing_that_the_library_keeps_holds_a_scene():
    walker = gp.MovingEntity("p", "adult", size=[0.2, 0.8], t=[0.0], position=[[0.6, 0.0, 0.8]])
    task = fresh("desk").tasks["bring_coffee"]
    scene, path = task.scene.with_moving(walker), gp.Path(np.stack([task.start, task.start + 0.1]))
    cost = gp.ImpactCost(model=gp.FailureMixture(faults="service_robot"))
    assert cost.state(StateBatch(scene, path.q)).shape == (2,)
    assert gp.ImpactCost().kernel(scene, (1.0, 1.0)) is not None
    first_collision(path, scene)
    watched = [weakref.ref(kept) for kept in (scene, compile_scene(scene))]
    assert reach(scene).shape == (7,)
    del task, scene
    gc.collect()
    assert [ref() for ref in watched] == [None, None]


def test_a_copied_scene_is_the_scene_and_pickling_gives_the_reason():
    scene = fresh("tabletop")
    assert copy.deepcopy(scene) is scene and copy.deepcopy({"a": [scene]})["a"][0] is scene
    with pytest.raises(TypeError, match=r"'tabletop'.*pickled"):
        pickle.dumps(scene)
    table = gp.SeverityTable.shipped()
    for again in (copy.deepcopy(table), pickle.loads(pickle.dumps(table))):
        assert again.rows == table.rows and again.components == table.components
        with pytest.raises(TypeError):
            again.rows["glass"]["medium"] = 0.0


def test_concurrent_plans_in_one_scene_equal_sequential_ones():
    task = fresh("tabletop").tasks["right_to_left"]

    def planned(seed):
        return gp.plan(task.start, task.goal, task.scene, seed=seed, iterations=25).unwrap().q

    alone = [planned(seed) for seed in (0, 1)]
    with ThreadPoolExecutor(4) as pool:
        for seed, q in enumerate(pool.map(planned, [0, 1, 0, 1])):
            np.testing.assert_array_equal(q, alone[seed % 2])
