"""Environments for Gymnasium: its own checker, episodes repeatable by seed, and the vector environment as twin."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from failbench.fault.registry import faults
from failbench.policies.gym import registered
from failbench.policies.gym.environment import FailBenchEnv, FailBenchVectorEnv
from failbench.policies.gym.registration import register
from failbench.policies.gym.wrappers import WithFaults
from failbench.policies.policy import PolicyError
from failbench.policies.task import PolicySettings, policy_task
from graceful_plan.exceptions import SettingError, ShapeError, UnknownNameError

SHORT = PolicySettings(limit=0.5, horizon=0.1)
DELAY = faults()["control_delay"](degree="severe", targets=("all",))


@pytest.fixture(scope="module")
def short():
    return policy_task("tabletop_l1/green_to_blue", SHORT)


@pytest.fixture(autouse=True)
def _renamed():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize(
    "action",
    [
        "joint_velocity",
        pytest.param("joint_position", marks=pytest.mark.long),
        pytest.param("tool_pose", marks=pytest.mark.long),
    ],
)
def test_gymnasium_finds_nothing_wrong(short, action):
    check_env(FailBenchEnv(short, DELAY, action=action), skip_render_check=True)


def test_every_scenario_is_registered():
    names = [name for name in gymnasium.registry if name.startswith("FailBench/")]
    assert set(registered.NAMES) == set(names) and len(names) > 2000
    assert "FailBench/desk.lift_coffee.noise.severe" in names and "FailBench/desk.lift_coffee" in names
    assert register("desk/lift_coffee/noise/severe") == (
        "FailBench/desk.lift_coffee",
        "FailBench/desk.lift_coffee.noise.severe",
    )
    with pytest.raises(UnknownNameError):
        register("nowhere/*")


def test_registered_environments_can_be_made():
    made = gymnasium.make("FailBench/tabletop_l1.green_to_blue.noise.severe", settings=SHORT, action="tool_pose")
    assert made.action_space.shape == (6,)
    assert made.unwrapped.core.faulting.fault == faults()["noise"](degree="severe")
    many = gymnasium.make_vec("FailBench/tabletop_l1.green_to_blue", num_envs=2, settings=SHORT)
    assert isinstance(many, FailBenchVectorEnv) and many.core.faulting.fault is None
    made.close()
    many.close()


def test_the_same_seed_is_the_same_episode_also_among_many(short):
    many, one = FailBenchVectorEnv(3, short, DELAY), FailBenchEnv(short, DELAY)
    rng = np.random.default_rng(1)
    seen, _ = many.reset(seed=7)
    alone, _ = one.reset(seed=8)
    np.testing.assert_array_equal(seen[1], alone)
    for _ in range(40):  # an episode has 25 steps; the vector environment then starts the next one
        actions = rng.uniform(-1.0, 1.0, (3, 7)).astype(np.float32)
        seen, rewards, ended, cut, infos = many.step(actions)
        if restarted := one.core.episode(0).timed_out:
            alone, _ = one.reset()
            reward, gone, late, info = 0.0, False, False, {}
        else:
            alone, reward, gone, late, info = one.step(actions[1])
        np.testing.assert_array_equal(seen[1], alone)
        assert (rewards[1], ended[1], cut[1]) == (reward, gone, late)
        if info:
            assert not restarted and infos["rollout"][1].onset == info["rollout"].onset
    assert not np.array_equal(seen[0], seen[1])


def test_rewards_are_progress_and_the_last_info_has_the_outcome(short):
    env = FailBenchEnv(short, harm_weight=0.0, settings=SHORT)
    env.reset(seed=0)
    whole, q = 0.0, env.core.episode(0).qpos[short.world.robot.qpos].copy()
    for _ in range(25):
        _, reward, ended, cut, info = env.step(np.sign(short.goal - q).astype(np.float32) * 0.5)
        whole += reward
    after = env.core.episode(0).qpos[short.world.robot.qpos]
    far = np.linalg.norm(q - short.goal), np.linalg.norm(after - short.goal)
    assert cut and not ended
    assert whole == pytest.approx((far[0] - far[1]) / np.linalg.norm(short.start - short.goal))
    assert info["is_success"] is False and info["harm"] == info["rollout"].harm(short.scene)


def test_options_and_wrappers_choose_the_fault(short):
    env = FailBenchEnv(short)
    env.reset(seed=0, options={"fault": DELAY, "onset": 0.2})
    assert env.core.episode(0).onset == 100
    env.reset(seed=0)
    assert env.core.episode(0).job is None
    with pytest.raises(SettingError):
        env.reset(options={"falt": DELAY})
    noise = faults()["noise"](degree="minor")
    wrapped = WithFaults(env, [DELAY, noise], healthy=0.5, shares=[1.0, 3.0])
    drawn = [wrapped.reset(seed=i)[1]["fault"] for i in range(24)]
    counts = {name: drawn.count(name) for name in set(drawn)}
    assert set(counts) == {"", "control_delay/severe", "noise/minor"}
    assert 5 < counts[""] < 19 and counts["noise/minor"] > counts["control_delay/severe"]
    assert wrapped.reset(seed=3)[1] == wrapped.reset(seed=3)[1]
    for wrong in ({"faults": []}, {"faults": [DELAY], "healthy": 2.0}, {"faults": [DELAY], "shares": [0.0]}):
        with pytest.raises(SettingError):
            WithFaults(env, **wrong)


def test_unknown_names_are_refused(short):
    for wrong in ({"action": "command"}, {"reward": "fame"}, {"render_mode": "human"}):
        with pytest.raises(UnknownNameError):
            FailBenchEnv(short, **wrong)
    with pytest.raises(UnknownNameError):
        FailBenchVectorEnv(2, short, rewards="success")


@pytest.mark.long
def test_policies_see_pictures_and_so_do_people(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    pytest.importorskip("mujoco.egl")
    settings = PolicySettings(limit=0.2, cameras=("overview",), size=(48, 64))
    env = FailBenchEnv("tabletop_l1/green_to_blue", settings=settings, render_mode="rgb_array")
    check_env(env, skip_render_check=True)
    first, _ = env.reset(seed=0)
    for _ in range(8):
        last, *_ = env.step(np.ones(7, dtype=np.float32))
    assert first["overview"].shape == (48, 64, 3) and first["overview"].std() > 5
    assert np.abs(first["overview"].astype(int) - last["overview"]).max() > 20
    assert env.render().shape == (48, 64, 3)
    env.close()
    env.close()


@pytest.mark.long
def test_stable_baselines_finds_nothing_wrong():
    """Every task with one of the kinds of action; run by `make test-policies`."""
    checker = pytest.importorskip("stable_baselines3.common.env_checker", exc_type=ImportError)
    for i, name in enumerate(name for name in registered.NAMES if name.count(".") == 1):
        action = ("joint_velocity", "joint_position", "tool_pose")[i % 3]
        env = gymnasium.make(name, settings=SHORT, action=action).unwrapped
        checker.check_env(env, skip_render_check=True)
        env.close()


def test_invalid_actions_and_options_are_refused(short):
    env = FailBenchEnv(short)
    nothing = np.zeros(7)
    with pytest.raises(SettingError, match="reset it first"):
        env.step(nothing)
    env.reset(seed=0)
    for wrong in (np.full(7, np.nan), np.zeros(3), np.array(["a"] * 7)):
        with pytest.raises((PolicyError, ShapeError)):
            env.step(wrong)
    for options in ({"onset": np.nan}, {"onset": -1.0}, {"onset": "soon"}):
        with pytest.raises(SettingError, match="onset"):
            env.reset(options={"fault": DELAY, **options})
    with pytest.raises(SettingError, match="fault"):
        env.reset(options={"fault": "gripper_failure"})
    env.reset(seed=0)
    while not env.step(nothing)[3]:
        pass
    with pytest.raises(SettingError, match="reset it first"):
        env.step(nothing)
    with pytest.raises(SettingError, match="harm_weight"):
        FailBenchEnv(short, harm_weight=np.nan)
    for count in (0, 10**9):
        with pytest.raises(SettingError, match="num_envs"):
            FailBenchVectorEnv(count, short)
    many = FailBenchVectorEnv(2, short)
    many.reset(seed=0)
    with pytest.raises(ShapeError, match="row"):
        many.step(np.zeros((1, 7)))


@pytest.mark.parametrize(
    "wrong",
    [
        {"period": float("nan")}, {"period": 1e300}, {"limit": float("nan")}, {"horizon": 1e300}, {"noise": 1e300},
        {"dwell": 1e300}, {"speed": float("nan")}, {"reach": (float("nan"), 1.0)}, {"size": (0, 1)},
    ],
    ids=str,
)  # fmt: skip
def test_episodes_without_end_are_refused(wrong):
    with pytest.raises(SettingError, match=next(iter(wrong))):
        PolicySettings(**wrong)
