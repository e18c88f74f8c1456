"""Invalid names are refused before MuJoCo, which crashes on None and cuts a text at its first null character."""

import subprocess
import sys

import mujoco
import pytest

import graceful_plan as gp
from graceful_plan.exceptions import SceneError, UnknownNameError
from graceful_plan.scene.loading.naming import is_name, lookup

SCENE = gp.load_scene("tabletop")
BODY = mujoco.mjtObj.mjOBJ_BODY
ENTITY = next(name for name in SCENE.entities if lookup(SCENE.model, BODY, name) > 0)
TETRAHEDRON = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
NO_NAMES = ["", "\ud800", f"{ENTITY}\0x"]
OTHERS = ["nobody", "#²", "#" + "9" * 5000, "#-1", "名前 🙂"]


@pytest.mark.parametrize("name", [*NO_NAMES, None, 5, b"vase", ["vase"]])
def test_impossible_names_match_nothing(name):
    assert not is_name(name)
    assert lookup(SCENE.model, BODY, name) == -1


def test_names_in_any_script_are_names():
    scene = SCENE.add_box("名前 🙂", [0.1, 0.1, 0.1], [1.0, 1.0, 1.0])
    assert is_name("名前 🙂") and lookup(scene.model, BODY, "名前 🙂") > 0
    assert scene.edit(remove=["名前 🙂"]).model.nbody == SCENE.model.nbody


@pytest.mark.parametrize("name", NO_NAMES + OTHERS)
def test_missing_names_raise_the_librarys_errors(name):
    for ask in (
        lambda: SCENE.edit(remove=[name]),
        lambda: SCENE.edit(move={name: [1.0, 1.0, 1.0]}),
        lambda: SCENE.attach(name),
        lambda: SCENE.with_allowed_contacts(gp.AllowedContact(name, ENTITY)),
        lambda: SCENE.with_allowed_contacts(gp.AllowedContact(ENTITY, name)),
    ):
        with pytest.raises(UnknownNameError):
            ask()


@pytest.mark.parametrize("name", NO_NAMES)
def test_nothing_gets_a_name_that_cannot_be_one(name):
    for add, size in ((SCENE.add_box, [0.1, 0.1, 0.1]), (SCENE.add_mesh, TETRAHEDRON)):
        with pytest.raises(SceneError, match="empty"):
            add(name, size, [1.0, 1.0, 1.0])
    with pytest.raises(SceneError, match="needs a name"):
        gp.MovingEntity(name, "adult", size=[0.1, 0.1], t=[0.0], position=[[1.0, 1.0, 1.0]])


@pytest.mark.parametrize("given", [{"tool": "\ud800"}, {"tool": "r/t\0"}, {"tool": ""}, {"robot": "\ud800"}])
def test_a_robot_is_named_by_a_name(given):
    text = "<mujoco><worldbody><body name='r/a'><joint/><geom size='1'/><site name='r/t'/></body></worldbody></mujoco>"
    with pytest.raises(UnknownNameError):
        gp.Scene.from_mjcf(text, **{"robot": "r/", "tool": "r/t", **given})


def test_a_name_may_be_given_twice_for_removal():
    gone = SCENE.edit(remove=[ENTITY, ENTITY])
    assert lookup(gone.model, BODY, ENTITY) == -1


ODD = """
import graceful_plan as gp
scene = gp.load_scene("tabletop")
q = scene.tasks["right_to_left"].start
motion, path = gp.Trajectory([0.0, 1.0], [q, q], [0 * q, 0 * q], [0 * q, 0 * q], scene.joints), gp.Path([q, q + 1.0])
calls = {
    "remove": lambda: scene.edit(remove=[odd]),
    "move": lambda: scene.edit(move={None: [1, 1, 1]}),
    "add": lambda: scene.edit(add=[odd]),
    "attach": lambda: scene.attach(odd),
    "box": lambda: scene.add_box(odd, [0.1, 0.1, 0.1], [1, 1, 1]),
    "size": lambda: scene.add_sphere("ball", {}, [1, 1, 1]),
    "entity": lambda: scene.add_sphere("ball", 0.1, [1, 1, 1], entity=[]),
    "contacts": lambda: scene.with_allowed_contacts(odd),
    "contact": lambda: scene.with_allowed_contacts(gp.AllowedContact(odd, odd)),
    "moving": lambda: scene.with_moving(odd),
    "spread": lambda: gp.MovingEntity("a", "adult", size=[1, 1], t=[0], position=[[1, 1, 1]], spread="x"),
    "robot": lambda: gp.Scene.from_mjcf("<mujoco/>", robot=odd, tool="tool"),
    "scene of plan": lambda: gp.plan(q, q, odd),
    "callback": lambda: gp.plan(q, q, scene, callback="x"),
    "scene of clearance": lambda: gp.clearance(q, odd),
    "scene of verify": lambda: gp.verify(motion, odd),
    "scene of evaluate": lambda: gp.evaluate(motion, odd),
    "motion of verify": lambda: gp.verify(odd, scene),
    "objective": lambda: gp.evaluate(motion, scene, "x"),
    "start time": lambda: gp.evaluate(motion, scene, start_time="x"),
    "w": lambda: gp.Objective(w="x"),
    "tilt": lambda: gp.Upright(max_tilt="x"),
    "volume": lambda: gp.Liquid("x"),
    "range": lambda: gp.RRTStar(range="x"),
    "seconds": lambda: motion.delayed("x"),
    "dt": lambda: motion.sample("x"),
    "step": lambda: path.resampled("x"),
}
for name, call in calls.items():
    for odd in (None, 5):
        try:
            call()
            print(name, "took", odd)
        except gp.GracefulPlanError as error:
            assert str(error)
        except Exception as error:
            print(name, repr(error))
"""


def test_arguments_of_other_types_are_refused_by_name():
    """Run in a separate process without type checks: None used to crash there."""
    run = subprocess.run([sys.executable, "-c", ODD], capture_output=True, text=True, check=False, timeout=300)
    assert (run.returncode, run.stdout, run.stderr[-2000:]) == (0, "", "")
