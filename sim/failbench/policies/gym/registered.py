"""All scenarios are registered by importing this: `gymnasium.make("failbench.policies.gym.registered:FailBench/...")`.

Gymnasium imports what stands before the colon; whoever does not want that calls `registration.register` instead.
"""

from failbench.policies.gym.registration import register

NAMES = register()
