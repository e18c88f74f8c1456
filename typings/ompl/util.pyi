"""OMPL's own stubs miss what its classes can do (indexing of states, for one)."""

from typing import Any

def __getattr__(name: str) -> Any: ...
