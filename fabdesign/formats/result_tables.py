"""Results and designs that a person looks at in Python: as lines, as a table, as JSON. Needs no heavy library unless
asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fabdesign.errors import InputError, needs
from fabdesign.formats.json_file import plain
from fabdesign.units import in_mm

if TYPE_CHECKING:
    import pandas

    from fabdesign.nouns.design import Design
    from fabdesign.nouns.model import Model

Columns = dict[str, Any]  # sequences of one length, by name
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


def design_summary(design: Design) -> Summary:
    """Return the cloth in a line, a row a muscle, and the layout drawn flat."""
    from fabdesign.drawings.layout_drawing import layout_svg

    fabric = design.fabric
    hung = fabric.hung if isinstance(fabric.hung, str) else f"{len(fabric.hung)} points"
    head = (
        f"design {design.name}: cloth {in_mm(fabric.width):g} x {in_mm(fabric.height):g} mm, hung: {hung}; "
        f"{len(design.muscles)} muscles on {design.channels} channels"
    )
    return Summary([head], muscle_columns(design), [layout_svg(design)])


def muscle_columns(design: Design) -> dict[str, list[Any]]:
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


class Tabled:
    """A result that can be a table, and shows itself in some lines."""

    def summary(self) -> Summary:
        """Return what `print` and a notebook show."""
        return Summary([f"{type(self).__name__}:"], self.columns())

    def __str__(self) -> str:
        return self.summary().text()

    def _repr_html_(self) -> str:
        return self.summary().html()

    def columns(self) -> Columns:
        """Return the table's, by name: sequences of the same length, in the units of the command's output."""
        raise NotImplementedError

    def to_table(self) -> pandas.DataFrame:
        """Return the table. Needs the extra `tables`."""
        try:
            import pandas
        except ModuleNotFoundError as error:
            raise InputError(needs(error)) from None
        return pandas.DataFrame(dict(self.columns()))

    def to_parquet(self, path: Path | str) -> None:
        """Write the table as a Parquet file."""
        self.to_table().to_parquet(path, index=False)

    def to_json(self) -> dict[str, Any]:
        """Return what the command's `--json` prints, but for the files that it names."""
        return dict(plain(self))


class OfModel(Tabled):
    """A result that is a model first of all."""

    model: Model

    def columns(self) -> Columns:
        """Return name, value, unit, low90, high90, scope of every parameter of the model."""
        rows = [(name, p.factor, "", p.interval90, p.scope) for name, p in self.model.parameters.items()]
        rows += [
            (f"{effect.name}.{name}", q.value, q.unit, q.interval90, effect.scope)
            for effect in self.model.effects
            for name, q in effect.parameters.items()
        ]
        nan = float("nan")
        cells = [(name, value, unit, *(ends or (nan, nan)), scope) for name, value, unit, ends, scope in rows]
        names = ("name", "value", "unit", "low90", "high90", "scope")
        return {name: [row[k] for row in cells] for k, name in enumerate(names)}


def by_name(rows: Sequence[Mapping[str, Any]]) -> Columns:
    """Return columns of rows that may lack some."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: [row.get(name, float("nan")) for row in rows] for name in names}
