# Only what failbench names in annotations; pyarrow ships no types.
from collections.abc import Iterator
from typing import Any

class Field:
    name: str
    type: Any
    metadata: dict[bytes, bytes] | None

class Schema:
    metadata: dict[bytes, bytes] | None
    def __iter__(self) -> Iterator[Field]: ...
    def __getattr__(self, name: str) -> Any: ...

class Table:
    schema: Schema
    num_rows: int
    @classmethod
    def from_pylist(cls, mapping: Any, schema: Schema) -> Table: ...
    def __getattr__(self, name: str) -> Any: ...

def __getattr__(name: str) -> Any: ...
