"""FailBench: execute a trajectory in MuJoCo, break the robot, and record all hits and their force.

It uses only the public interface of `graceful_plan`, which never imports it.
"""

from graceful_plan import lazy_imports

lazy_imports.install(__name__)
