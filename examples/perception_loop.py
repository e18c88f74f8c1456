"""A perception loop at 20 Hz: an arm carries coffee to and fro while a box moves through its way."""

import time

import numpy as np

import graceful_plan as gp

PERIOD, AHEAD, LIMIT = 0.05, 0.1, 0.03  # between measurements, from one to the takeover, of each call [s]
SPEED = 0.5  # at full speed, no stop keeps a full cup from spilling


def measured(now: float) -> dict[str, np.ndarray]:
    """Simulate a camera: the box moves into the way and out of it; return X_WB of the moved body."""
    X_WB = np.eye(4)
    X_WB[:3, 3] = [0.62 + 0.12 * np.cos(0.5 * now), 0.0, 0.95]
    return {"crate": X_WB}


def main(seconds: float = 6.0, iterations: int | None = None) -> tuple[gp.Trajectory, list[float]]:
    """Return the executed motion and the time of each call [s]; with `iterations` instead of a limit, none is late."""
    task, now, took = gp.load_scene("desk").tasks["bring_coffee"], 0.0, list[float]()
    scene = task.scene.add_box("crate", [0.06] * 3, [0.74, 0.0, 0.95])  # 2 cm larger, since it moves until the next one
    goals, limit = [np.atleast_2d(task.goal)[0], np.asarray(task.start)], None if iterations else LIMIT
    motion = gp.plan(task.start, goals[0], scene, speed=SPEED, iterations=60).unwrap()
    while now < seconds:
        began, at = time.perf_counter(), now + AHEAD
        scene = scene.edit(move=measured(now))  # only the moved body is compiled again
        if now > motion.t[-1] and np.allclose(motion.q[-1], goals[0]):
            goals.reverse()  # arrived
        result = gp.replan(motion, scene, at=at, goal=goals[0], speed=SPEED, time_limit=limit, iterations=iterations)
        took.append(time.perf_counter() - began)
        if result.trajectory is not None and (iterations or took[-1] < AHEAD):  # a late result is of no use
            motion = motion.spliced(result.trajectory)
        now += PERIOD if iterations else max(PERIOD, took[-1])
    return motion, took


if __name__ == "__main__":
    print(f"median {1e3 * np.median(main()[1]):.0f} ms")
