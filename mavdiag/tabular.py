"""Values as tables: HTML for a notebook, a pandas frame and its plot. pandas is only loaded when it is asked for."""

from collections.abc import Mapping, Sequence
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

from mavdiag.errors import check_installed

if TYPE_CHECKING:
    from pandas import DataFrame


class Tabular:
    """A value that a notebook shows as a table."""

    __slots__ = ()

    def columns(self) -> Mapping[str, Sequence[Any]]:
        """Its table: equally long columns by name, the first of them naming the rows."""
        raise NotImplementedError

    def to_frame(self) -> "DataFrame":
        """The table as a pandas frame, its first column the index. Raises UsageError without pandas."""
        columns = dict(self.columns())
        frame: DataFrame = pandas().DataFrame(columns).set_index(next(iter(columns)))
        return frame

    def plot(self, **options: Any) -> Any:
        """Draw the frame's numbers; options as of `pandas.DataFrame.plot`."""
        return self.to_frame().select_dtypes("number").plot(**options)

    def _repr_html_(self) -> str:
        columns = self.columns()
        head = "".join(f"<th>{escape(name)}</th>" for name in columns)
        rows = zip(*columns.values(), strict=True)
        body = "".join(f"<tr>{''.join(f'<td>{escape(_shown(value))}</td>' for value in row)}</tr>" for row in rows)
        title = f"<p>{escape(line)}</p>" if (line := next(iter(str(self).splitlines()), "")) else ""
        return f"{title}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def pandas() -> Any:
    """The library. Raises UsageError without it."""
    check_installed("a frame", "pandas", "export")
    return import_module("pandas")


def _shown(value: object) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
