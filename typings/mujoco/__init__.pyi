"""MuJoCo's names come from extension modules without stubs; the type checker takes them as they are."""

from typing import Any

def __getattr__(name: str) -> Any: ...
