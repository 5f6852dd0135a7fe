"""Results that a person looks at in Python: as lines, as a table, as JSON. Needs no heavy library unless asked."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from fabdesign.errors import InputError, needs
from fabdesign.formats.summary import Summary

if TYPE_CHECKING:
    import pandas

    from fabdesign.nouns.model import Model

Columns = dict[str, Any]  # sequences of one length, by name


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
        as_json: dict[str, Any] = self.as_json()  # type: ignore[attr-defined]
        return as_json


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
