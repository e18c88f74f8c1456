"""A custom robot from a few lines of MJCF: plan with w = 0 and w = 1, and simulate failures along both motions."""

import failbench as fb
import graceful_plan as gp

ARM = """<mujoco><worldbody>
  <body name="table" pos=".45 0 .2"><geom type="box" size=".3 .5 .2"/></body>
  <body name="vase" pos=".48 0 .5"><freejoint/><geom type="cylinder" size=".04 .1" mass=".5"/></body>
  <body name="arm/base" pos="0 0 .5"><body name="arm/turn"><joint name="arm/turn" axis="0 0 1" range="-170 170"/>
    <geom type="capsule" fromto="0 0 -.1 0 0 .2" size=".05" mass="3"/>
    <body name="arm/upper" pos="0 0 .25"><joint name="arm/upper" axis="0 1 0" range="-110 110"/>
      <geom type="capsule" fromto=".05 0 0 .3 0 0" size=".04" mass="2"/>
      <body name="arm/fore" pos=".35 0 0"><joint name="arm/fore" axis="0 1 0" range="-140 140"/>
        <geom type="capsule" fromto=".05 0 0 .2 0 0" size=".035" mass="1"/><site name="arm/tool" pos=".3 0 0"/>
  </body></body></body></body>
  <body name="cup" pos=".68 0 .75"><freejoint/><geom type="cylinder" size=".03 .04" mass=".2"/></body>
</worldbody><actuator>
  <position name="arm/turn" joint="arm/turn" kp="900" kv="90" forcerange="-90 90"/>
  <position name="arm/upper" joint="arm/upper" kp="900" kv="90" forcerange="-90 90"/>
  <position name="arm/fore" joint="arm/fore" kp="500" kv="50" forcerange="-60 60"/>
</actuator></mujoco>"""
LIMITS = {"velocity": [2.0] * 3, "acceleration": [8.0] * 3}  # [rad/s] and [rad/s^2]
START, GOAL = [-0.8, -0.4, 0.6], [0.8, -0.4, 0.6]


def main(iterations: int | None = None, n: int = 20) -> dict[float, gp.PlanResult]:
    """Plan with w = 0 and w = 1, let FailBench drop the cup n times along each motion, and return both results."""
    entities = {"vase": "glass", "table": "table"}
    scene = gp.Scene.from_mjcf(
        ARM, robot="arm/", tool="arm/tool", carried="cup", at=[0, 0, 0], entities=entities, **LIMITS
    )
    results = {w: gp.plan(START, GOAL, scene, w=w, iterations=iterations) for w in (0.0, 1.0)}
    for w, result in results.items():
        seen = fb.validate(result, scene, n=n, settings=fb.SimSettings(grasp="weld"))
        print(f"w = {w:g}: {seen.duration:.1f} s, harm of a failure: {seen.predicted:.2f}, observed {seen.observed}")
    return results


if __name__ == "__main__":
    main()
