"""A perception loop with a period of 0.05 s: an arm carries coffee to and fro while a box moves through its way."""

import time

import numpy as np

import graceful_plan as gp

PERIOD, AHEAD = 0.05, 0.2  # between measurements, and from a call to the takeover [s]
LIMIT = 0.035  # time limit of a call [s]
SPEED = 0.5  # at full speed, no stop keeps a full cup from spilling


def measured(now: float) -> dict[str, np.ndarray]:
    """Simulate a camera: the box moves into the way and out of it; return p_WB of the moved body."""
    return {"crate": np.array([0.62 + 0.12 * np.cos(0.5 * now), 0.0, 0.95])}


def main(seconds: float = 6.0, iterations: int | None = None) -> tuple[gp.Trajectory, list[float]]:
    """Return the executed motion and the time of each call [s]; with `iterations` instead of a limit, none is late."""
    task, now, took = gp.load_scene("desk").tasks["bring_coffee"], 0.0, list[float]()
    scene = task.scene.add_box("crate", [0.06] * 3, [0.74, 0.0, 0.95])  # 2 cm larger, since it moves until the next one
    goals = [np.atleast_2d(task.goal)[0], np.asarray(task.start)]
    motion = gp.plan(task.start, goals[0], scene, speed=SPEED, iterations=60).unwrap()
    while now < seconds:
        began, at, limit = time.perf_counter(), now + AHEAD, None if iterations else LIMIT
        arrived = now > motion.t[-1] and np.allclose(motion.q[-1], goals[0])
        goals = goals[::-1] if arrived else goals
        scene = scene.edit(move=measured(now))  # no model is copied
        result = gp.replan(motion, scene, at=at, goal=goals[0], speed=SPEED, time_limit=limit, iterations=iterations)
        took += [time.perf_counter() - began]
        if result.trajectory is not None and (iterations or now + took[-1] < at):  # a late result is of no use
            motion = motion.spliced(result.trajectory)
        now += PERIOD if iterations else max(PERIOD, took[-1])
    return motion, took


if __name__ == "__main__":
    print(np.round(main()[1], 3))
