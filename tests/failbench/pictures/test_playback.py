"""Pictures of failures: right number and size, true to the simulation, refused with a reason where impossible."""

import contextlib
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from itertools import pairwise
from types import ModuleType

import mujoco
import numpy as np
import pytest
from breaking import Nothing
from motions import EVERY_DEGREE, Drop, Shake, Weaken, arm, execution
from PIL import Image
from places import ROOT

from failbench import Fault, RolloutRequest, SimSettings, build_world, faults, run_rollouts
from failbench.basics.errors import NoPicture
from failbench.pictures import contact_sheet, film, offscreen
from failbench.pictures.drawing import TouchPaint, outlined
from failbench.pictures.playback import film as moments_of
from failbench.pictures.playback import replay
from failbench.simulated.states import STATE
from graceful_plan.exceptions import FormatError, SettingError, UnknownNameError

SIZE = (96, 72)
LATE = RolloutRequest(fault=Drop(), onset=0.4, seed=0)


@dataclass(frozen=True, kw_only=True)
class Explode(Fault):
    """A fault that pushes joints in proportion to their speed."""

    NAME = "explode"
    CATEGORY = "actuator"
    PARAMETER = "nothing"
    AMOUNTS = EVERY_DEGREE
    TARGETS = ("all",)
    FIELDS = ("dof_damping",)

    def apply(self, plant, level):
        plant["dof_damping"][plant.robot.dofs] = -1e7


@pytest.fixture(scope="module")
def done():
    return execution()


@pytest.fixture(scope="module")
def gl(done):
    """Skip without off-screen OpenGL."""
    try:
        with offscreen.Offscreen(done.world.model, 16, 16):
            pass
    except NoPicture as error:
        pytest.skip(f"no picture can be made on this machine: {error}")


def images(files):
    return [np.asarray(Image.open(file)) for file in files]


def above_caption(image):
    return image[: len(image) // 2]


@pytest.mark.usefixtures("gl")
class TestFrames:
    def test_frames_are_numbered_and_have_the_given_size(self, done, tmp_path):
        files = replay(done, LATE, output=tmp_path / "a" / "b", horizon=0.2, lead=0.1, fps=20.0, size=SIZE)
        assert [file.name for file in files] == [f"{i:05d}.png" for i in range(6)]
        assert sorted((tmp_path / "a" / "b").iterdir()) == list(files)
        frames = images(files)
        assert {frame.shape for frame in frames} == {(72, 96, 3)}
        assert all(not np.array_equal(a, b) for a, b in pairwise(frames))

    @pytest.mark.long
    def test_a_failure_looks_healthy_until_its_onset(self, done, tmp_path):
        settings = {"horizon": 0.3, "lead": 0.1, "fps": 20.0, "size": SIZE}
        broken = images(replay(done, LATE, output=tmp_path / "broken", **settings))
        intact = images(replay(done, replace(LATE, fault=Nothing()), output=tmp_path / "intact", **settings))
        same = [np.array_equal(above_caption(a), above_caption(b)) for a, b in zip(broken, intact, strict=True)]
        assert same[:3] == [True] * 3
        assert not any(same[4:])

    @pytest.mark.long
    def test_slow_motion_has_more_frames(self, done, tmp_path):
        settings = {"horizon": 0.1, "lead": 0.0, "fps": 20.0, "size": SIZE}
        assert len(replay(done, LATE, output=tmp_path / "once", **settings)) == 2
        assert len(replay(done, LATE, output=tmp_path / "slow", slow=5.0, **settings)) == 10

    def test_the_lead_ends_where_the_motion_begins(self, done, tmp_path):
        job = replace(LATE, onset=0.1)
        assert len(replay(done, job, output=tmp_path / "x", horizon=0.1, lead=9.0, fps=10.0, size=SIZE)) == 2

    @pytest.mark.parametrize("suffix", film.ANIMATED)
    def test_animated_images_hold_every_frame(self, done, tmp_path, suffix):
        output = tmp_path / f"new/film{suffix}"
        assert replay(done, LATE, output=output, horizon=0.2, lead=0.0, fps=20.0, size=SIZE) == (output,)
        with Image.open(output) as image:
            assert (image.size, image.n_frames, image.info.get("loop", 0)) == (SIZE, 4, 0)
            image.seek(1)
            image.load()
            assert image.info["duration"] == pytest.approx(50.0)

    def test_gif_durations_are_capped_by_the_format(self, done, tmp_path):
        replay(done, LATE, output=tmp_path / "x.gif", horizon=0.1, lead=0.0, fps=60.0, size=SIZE)
        with Image.open(tmp_path / "x.gif") as image:
            assert image.info["duration"] == 20.0

    @pytest.mark.long
    def test_video(self, done, tmp_path):
        imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
        output = tmp_path / "film.mp4"
        replay(done, LATE, output=output, horizon=0.5, lead=0.0, fps=20.0, size=SIZE)
        frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(output))
        assert (frames, seconds) == (10, pytest.approx(0.5))

    @pytest.mark.long
    def test_the_same_rollout_gives_the_same_bytes(self, done, tmp_path):
        one, other = (
            replay(done, LATE, output=tmp_path / name, horizon=0.1, lead=0.0, fps=20.0, size=SIZE) for name in "ab"
        )
        assert [file.read_bytes() for file in one] == [file.read_bytes() for file in other]

    def test_a_diverging_simulation_is_shown_until_then(self, done, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        [rollout] = run_rollouts(done, [RolloutRequest(fault=Explode(), onset=0.4, seed=0)], horizon=0.3)
        assert (rollout.status, rollout.state is None) == ("diverged", False)
        files = replay(done, rollout, output=tmp_path / "x", horizon=0.3, lead=0.0, fps=100.0, size=SIZE)
        assert 1 <= len(files) < 30
        assert not (tmp_path / "MUJOCO_LOG.TXT").exists()

    @pytest.mark.long
    def test_a_named_camera_and_a_free_one_see_different_things(self, done, tmp_path):
        settings = {"horizon": 0.02, "lead": 0.0, "size": SIZE}
        free = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(done.world.model, free)
        pictures = [
            images(replay(done, LATE, output=tmp_path / str(i), camera=camera, **settings))[0]
            for i, camera in enumerate([None, "overview", free])
        ]
        assert np.array_equal(pictures[0], pictures[1])
        assert not np.array_equal(pictures[0], pictures[2])

    def test_without_an_overview_the_whole_scene_is_seen(self):
        model = build_world(arm()).model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        camera = offscreen.find_camera(model, None)
        with offscreen.Offscreen(model, 160, 120) as pictures:
            for name in ("vase", "link", "block"):
                seen = pictures.silhouette(data, camera, lambda view, name=name: draw_geom(view, model, data, name))
                rows, columns = np.nonzero(seen)
                assert len(rows), name
                assert 0 < rows.min() and rows.max() < 119 and 0 < columns.min() and columns.max() < 159, name


def draw_geom(view, model, data, name):
    geom = view.geoms[view.ngeom]
    source = model.geom(name)
    mujoco.mjv_initGeom(
        geom, source.type[0], source.size, data.geom(name).xpos, data.geom(name).xmat, np.ones(4, dtype=np.float32)
    )
    view.ngeom += 1


def test_the_film_is_the_rollout(done):
    last, before = None, None
    for moment in moments_of(done, LATE, horizon=0.3, lead=0.1):
        if moment.time < 0.0:
            before = moment.data.qpos.copy()
        last = moment
    [rollout] = run_rollouts(done, [LATE], horizon=0.3)
    assert last.time == pytest.approx(0.3 - done.dt)
    assert not last.diverged
    start = mujoco.MjData(done.world.model)
    mujoco.mj_setState(done.world.model, start, done.states[done.checkpoint(LATE.onset)], STATE)
    model = done.world.model
    held = np.arange(7) + model.jnt_qposadr[model.body_jntadr[done.world.carried_body]]
    others = np.setdiff1d(np.arange(model.nq), held)
    assert before[others] == pytest.approx(start.qpos[others], abs=1e-5)  # sleeping objects wake up at the fork
    assert before[held] == pytest.approx(start.qpos[held], abs=1e-3)  # the held one creeps in the film
    for name, body in done.world.movable.items():
        adr = done.world.model.jnt_qposadr[done.world.model.body_jntadr[body]]
        position = last.data.qpos[adr : adr + 3]
        assert min(np.abs(rollout.poses[name][k : k + 3] - position).max() for k in (0, 4)) == 0.0


@pytest.mark.parametrize("fault", [Drop(), Weaken(degree="critical")])
@pytest.mark.parametrize("onset", [0.2, 0.5])
def test_marked_hits_equal_those_of_the_recorder(done, fault, onset):
    job = RolloutRequest(fault=fault, onset=onset, seed=0)
    touches = TouchPaint(done.world, done.baseline)
    for moment in moments_of(done, job, horizon=0.5, lead=0.1):
        touches.observe(moment.model, moment.data, moment.time)
    [rollout] = run_rollouts(done, [job], horizon=0.5)
    assert touches.struck == {event.entity for event in rollout.events if not event.secondary}
    assert touches.struck


def test_nothing_is_marked_where_nothing_fails(done):
    touches = TouchPaint(done.world, done.baseline)
    for moment in moments_of(done, replace(LATE, fault=Nothing()), horizon=0.3, lead=0.4):
        touches.observe(moment.model, moment.data, moment.time)
    view = mujoco.MjvScene(done.world.model, maxgeom=100)
    touches.draw(view)
    assert (touches.struck, view.ngeom) == (set(), 0)


def test_arrows_of_an_object_at_rest_carry_its_weight():
    done = execution(settings=SimSettings(grasp="weld", sleep=False))
    touches = TouchPaint(done.world, done.baseline)
    for moment in moments_of(done, RolloutRequest(fault=Drop(), onset=0.4, seed=0), horizon=1.5, lead=0.0):
        touches.observe(moment.model, moment.data, moment.time)
    view = mujoco.MjvScene(done.world.model, maxgeom=100)
    touches.draw(view)
    arrows = [geom for geom in view.geoms[: view.ngeom] if geom.type == mujoco.mjtGeom.mjGEOM_ARROW]
    assert arrows
    weight = 9.81 * done.world.model.body_mass[done.world.carried_body]
    down = 0.0
    for arrow in arrows:
        down -= arrow.mat[2, 2] * (arrow.size[2] / 0.01) ** 2  # z component of its axis, times its length
    assert down == pytest.approx(weight, rel=0.1)


def test_marks_beyond_the_room_for_them_are_left_out(done):
    touches = TouchPaint(done.world, done.baseline)
    for moment in moments_of(
        done, RolloutRequest(fault=Weaken(degree="critical"), onset=0.4, seed=0), horizon=0.4, lead=0.0
    ):
        touches.observe(moment.model, moment.data, moment.time)
    view = mujoco.MjvScene(done.world.model, maxgeom=2)
    touches.draw(view)
    assert view.ngeom == 2


def test_only_hit_entities_are_painted(done):
    touches = TouchPaint(done.world, done.baseline)
    model = build_world(done.world.scene).model
    touches.struck |= {"red1", "table"}
    touches.paint(model)
    changed = {model.geom(g).name for g in np.flatnonzero((model.geom_rgba != done.world.model.geom_rgba).any(axis=1))}
    assert changed == {"red1"}
    touches.struck.clear()
    touches.paint(model)
    assert np.array_equal(model.geom_rgba, done.world.model.geom_rgba)
    assert np.array_equal(model.geom_matid, done.world.model.geom_matid)


def test_an_outline_goes_around():
    square = np.zeros((20, 30), dtype=bool)
    square[5:15, 5:25] = True
    picture = outlined(np.full((20, 30, 3), 200, dtype=np.uint8), square)
    assert np.all(picture[~square] == 200)
    assert np.all(picture[5, 5:25] == picture[5, 5])
    assert np.all(picture[5, 5] != picture[10, 15])
    assert np.all(picture[10, 15] != 200)


@pytest.mark.parametrize("name", ["film.avi", "film.jpg", "film.png"])
def test_unknown_suffixes_are_refused_by_name(done, tmp_path, name):
    with pytest.raises(FormatError, match=rf"{name}: .*\.gif, \.webp, \.apng, \.mp4"):
        replay(done, LATE, output=tmp_path / name)


def test_frames_do_not_go_where_something_is(done, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(FormatError, match="file"):
        replay(done, LATE, output=tmp_path / "file")
    with pytest.raises(FormatError, match="empty"):
        replay(done, LATE, output=tmp_path)
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("setting", "value"),
    [("horizon", 0.0), ("lead", -1.0), ("fps", 0.0), ("fps", float("nan")), ("slow", 0.0), ("size", (8, 8))],
)
def test_settings_out_of_range_are_refused(done, tmp_path, setting, value):
    with pytest.raises(SettingError, match=f"^{setting} = "):
        replay(done, LATE, output=tmp_path / "x", **{setting: value})
    assert not (tmp_path / "x").exists()


def test_more_frames_than_steps_are_refused(done, tmp_path):
    with pytest.raises(SettingError, match=r"0\.002 s"):
        replay(done, LATE, output=tmp_path / "x", fps=60.0, slow=10.0)


def test_unknown_cameras_and_targets_are_refused(done, tmp_path):
    with pytest.raises(UnknownNameError, match=r"'above'.*overview"):
        replay(done, LATE, output=tmp_path / "x", camera="above")
    with pytest.raises(UnknownNameError, match="unknown target 'elbow'"):
        replay(done, replace(LATE, fault=Drop(targets=("elbow",))), output=tmp_path / "x")


def test_a_rollout_of_another_execution_is_refused(done, tmp_path):
    [rollout] = run_rollouts(done, [RolloutRequest(fault=Explode(), onset=0.4, seed=0)], horizon=0.1)
    with pytest.raises(SettingError, match="execution"):
        replay(done, replace(rollout, state=rollout.state + 1.0), output=tmp_path / "x")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere there is always a display")
class TestWithoutDisplay:
    @pytest.fixture(autouse=True)
    def no_display(self, monkeypatch):
        for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
            monkeypatch.delenv(name, raising=False)

    def test_without_a_viewer_the_error_names_the_alternative(self, done):
        with pytest.raises(NoPicture, match=r"display .*output='replay\.gif'"):
            replay(done, LATE)

    @pytest.mark.usefixtures("gl")
    def test_pictures_need_no_environment_variable(self, done, tmp_path):
        assert replay(done, LATE, output=tmp_path / "x", horizon=0.02, lead=0.0, size=SIZE)

    def test_without_egl_the_remedy_is_named(self, done, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "mujoco.egl", None)
        with pytest.raises(NoPicture, match=r"mujoco\.egl: .*MUJOCO_GL=egl"):
            replay(done, LATE, output=tmp_path / "x")
        assert not (tmp_path / "x").exists()

    def test_the_backend_of_mujoco_gl_is_used(self, done, tmp_path, monkeypatch):
        monkeypatch.setenv("MUJOCO_GL", "osmesa")
        monkeypatch.setitem(sys.modules, "mujoco.osmesa", None)
        with pytest.raises(NoPicture, match=r"\(mujoco\.osmesa: "):
            replay(done, LATE, output=tmp_path / "x")


def test_video_without_its_encoder_names_the_extra(done, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(NoPicture, match=r"pip install '\.\[viz\]'"):
        replay(done, LATE, output=tmp_path / "film.mp4")


class Viewer:
    """Stub of MuJoCo's viewer, whose window closes after some frames."""

    def __init__(self, model, data, frames):
        self.model, self.data, self.frames = model, data, frames
        self.cam, self.user_scn = mujoco.MjvCamera(), mujoco.MjvScene(model, maxgeom=100)
        self.times, self.marks, self.yellow = [], [], []

    def lock(self):
        return contextlib.nullcontext()

    def is_running(self):
        return len(self.times) < self.frames

    def sync(self):
        self.times.append(self.data.time)
        self.marks.append(self.user_scn.ngeom)
        self.yellow.append(bool((self.model.geom_matid != self.clean).any()))


def test_the_viewer_plays_until_it_is_closed(done, monkeypatch):
    opened = []

    @contextlib.contextmanager
    def launch_passive(model, data):
        opened.append(Viewer(model, data, frames=14))
        opened[0].clean = model.geom_matid.copy()
        yield opened[0]

    viewers = ModuleType("mujoco.viewer")
    viewers.launch_passive = launch_passive
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewers)
    monkeypatch.setenv("DISPLAY", ":0")
    assert replay(done, LATE, horizon=0.4, lead=0.1, fps=200.0, slow=0.1) == ()
    [viewer] = opened
    expected = [-0.1 + 0.05 * i for i in range(10)]
    assert viewer.times == pytest.approx([*expected, *expected[:4]], abs=0.003)
    assert viewer.cam.fixedcamid == done.world.model.camera("overview").id
    assert (viewer.marks[0], viewer.yellow[0]) == (0, False)
    assert viewer.marks[9] > 0 and viewer.yellow[9]
    assert not viewer.yellow[10], "the second time begins with clean colours"


def test_importing_is_light_and_has_no_effects():
    code = """
import os, sys
before = dict(os.environ)
import failbench.pictures.playback, failbench.pictures.contact_sheet
assert dict(os.environ) == before, "environment changed"
print(*[name for name in ("PIL", "OpenGL", "imageio_ffmpeg", "mujoco.viewer") if name in sys.modules])
"""
    clean = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    finished = subprocess.run([sys.executable, "-c", code], env=clean, capture_output=True, text=True, check=False)
    assert (finished.stdout.strip(), finished.stderr, finished.returncode) == ("", "", 0)


BLIND = Shake(degree="minor", targets=("panda/joint1",))


def severity(done, event):
    return done.world.scene.entities[event.entity].severity[event.striker]


class TestContactSheet:
    def test_has_every_fault_in_few_words(self):
        assert list(contact_sheet.WORDS) == list(faults())
        assert all(len(words.split()) <= 6 for words in contact_sheet.WORDS.values())

    def test_shows_the_worst_blow(self, done):
        [worst] = contact_sheet.worst_of(done, ["gripper_failure"])
        spacing = done.duration / 12
        jobs = [RolloutRequest(fault=worst.job.fault, onset=i * spacing, seed=i) for i in range(12)]
        blows = [(e.energy * severity(done, e), e.time) for one in run_rollouts(done, jobs) for e in one.events]
        assert worst.job in jobs
        assert worst.time == pytest.approx(max(blows)[1] + 0.02)
        assert worst.text.startswith("object hits ")

    def test_shows_how_far_the_tool_strays_where_nothing_is_hit(self, done):
        rollouts = run_rollouts(
            done,
            [RolloutRequest(fault=Nothing(), onset=0.2, seed=0), RolloutRequest(fault=BLIND, onset=0.2, seed=0)],
            horizon=0.1,
        )
        assert not any(one.events for one in rollouts)
        worst = contact_sheet._worst(done, rollouts)
        assert worst.job.fault is BLIND
        assert worst.text.startswith("tool ")

    @pytest.mark.long
    @pytest.mark.usefixtures("gl")
    def test_is_a_page_of_cells(self, tmp_path, monkeypatch):
        monkeypatch.setattr(contact_sheet, "_MOMENTS", 2)
        words = {name: contact_sheet.WORDS[name] for name in ("gripper_failure", "power_loss", "scale_error")}
        monkeypatch.setattr(contact_sheet, "WORDS", words)
        output = contact_sheet.contact_sheet(tmp_path / "new" / "sheet.png")
        page = np.asarray(Image.open(output))
        assert page.shape == (384 + 2 * 14, 4 * 400 + 5 * 14, 3)
        cells = [page[14:314, 14 + 414 * i : 414 + 414 * i] for i in range(3)]
        assert all(np.any(a != b) for a, b in pairwise(cells))
        assert all(len(np.unique(cell.reshape(-1, 3), axis=0)) > 1000 for cell in cells)

    def test_the_documented_picture_exists_and_is_small(self):
        file = ROOT / "docs" / "images" / "faults.png"
        assert file.stat().st_size < 900_000
        with Image.open(file) as page:
            assert page.size == (4 * 414 + 14, 5 * 398 + 14)

    def test_its_command(self, monkeypatch, tmp_path):
        written = []
        monkeypatch.setattr(contact_sheet, "contact_sheet", written.append)
        monkeypatch.setattr(sys, "argv", ["contact_sheet", str(tmp_path / "x.png")])
        contact_sheet.main()
        assert written == [tmp_path / "x.png"]
