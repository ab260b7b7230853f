# What the campaign uses of pyarrow.
from collections.abc import Mapping, Sequence

class Table:
    @staticmethod
    def from_pylist(rows: Sequence[Mapping[str, object]]) -> Table: ...
