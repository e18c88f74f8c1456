# Only what failbench names in annotations; pyarrow ships no types.
from typing import Any

class Schema:
    def __getattr__(self, name: str) -> Any: ...

class Table:
    schema: Schema
    num_rows: int
    @classmethod
    def from_pylist(cls, mapping: Any, schema: Schema) -> Table: ...
    def __getattr__(self, name: str) -> Any: ...

def __getattr__(name: str) -> Any: ...
