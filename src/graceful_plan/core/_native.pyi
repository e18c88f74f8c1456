"""The native core; `kernels.py` and the native planners are its typed faces."""

from typing import Any

def __getattr__(name: str) -> Any: ...
