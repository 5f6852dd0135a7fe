"""Summaries, which `print` and a notebook show of an object: one line, some rows of a table, and a picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from fabdesign.units import in_mm

if TYPE_CHECKING:
    from fabdesign.nouns.design import Design

ROWS = 8  # shown; of more the number is said


@dataclass(frozen=True)
class Summary:
    """lines: what comes first. columns: cells by heading, sequences of one length. pictures: HTML."""

    lines: Sequence[str]
    columns: Mapping[str, Any]
    pictures: Sequence[str] = ()

    @property
    def _rows(self) -> list[list[str]]:
        shown = [[_cell(value) for value in list(values[:ROWS])] for values in self.columns.values()]
        return [list(row) for row in zip(*shown, strict=True)]

    @property
    def _more(self) -> str:
        count = max((len(values) for values in self.columns.values()), default=0)
        return f"... {count} rows in all" if count > ROWS else ""

    def text(self) -> str:
        """Return the lines and the table, about ten lines."""
        table = [list(self.columns), *self._rows]
        widths = [max(len(row[k]) for row in table) for k in range(len(self.columns))]
        rows = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in table]
        return "\n".join([*self.lines, *(f"  {row}" for row in rows if row), *filter(None, [self._more])])

    def html(self) -> str:
        """Return the same as HTML, with the pictures."""
        lines = "".join(f"<div>{escape(line)}</div>" for line in [*self.lines])
        head = "".join(f"<th>{escape(name)}</th>" for name in self.columns)
        body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self._rows)
        pictures = "".join(f'<div style="max-width: 40rem">{picture}</div>' for picture in self.pictures)
        return f"{lines}<table><tr>{head}</tr>{body}</table><div>{self._more}</div>{pictures}"


def design_summary(design: "Design") -> Summary:
    """Return the cloth in a line, a row a muscle, and the layout drawn flat."""
    from fabdesign.drawings.layout_drawing import layout_svg

    fabric = design.fabric
    hung = fabric.hung if isinstance(fabric.hung, str) else f"{len(fabric.hung)} points"
    head = (
        f"design {design.name}: cloth {in_mm(fabric.width):g} x {in_mm(fabric.height):g} mm, hung: {hung}; "
        f"{len(design.muscles)} muscles on {design.channels} channels"
    )
    return Summary([head], muscle_columns(design), [layout_svg(design)])


def muscle_columns(design: "Design") -> dict[str, list[Any]]:
    """Return type, side, channel and place of each muscle."""
    muscles = design.muscles
    return {
        "muscle": [*range(len(muscles))],
        "type": [muscle.type for muscle in muscles],
        "side": [muscle.side for muscle in muscles],
        "channel": [muscle.channel for muscle in muscles],
        "from u, v mm": [_place(muscle.path[0]) for muscle in muscles],
        "to u, v mm": [_place(muscle.path[-1]) for muscle in muscles],
        "length mm": [f"{in_mm(muscle.length):.1f}" for muscle in muscles],
    }


def _place(point: tuple[float, float]) -> str:
    return f"{in_mm(point[0]):.1f}, {in_mm(point[1]):.1f}"


def _cell(value: Any) -> str:
    return (
        f"{value:.4g}"
        if (hasattr(value, "dtype") and value.dtype.kind == "f") or isinstance(value, float)
        else str(value)
    )
