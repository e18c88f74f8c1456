"""FailBench: execute a trajectory in MuJoCo, inject failures, and record what was really hit, and how hard.

It will hold scenarios, faults (one file a category), executor, recorder, rollout, score and dataset. It uses what is
public in `graceful_plan`, which never imports it.
"""
