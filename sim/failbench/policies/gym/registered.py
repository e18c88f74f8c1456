"""Register all scenarios on import: `gymnasium.make("failbench.policies.gym.registered:FailBench/...")`.

Gymnasium imports the module before the colon. To register without this import, call `registration.register`.
"""

from failbench.policies.gym.registration import register

NAMES = register()
