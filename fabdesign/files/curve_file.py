"""A cloth's measured membrane law as a CSV: `strain,tension_n_per_m,direction`."""

from dataclasses import dataclass
from pathlib import Path

from fabdesign.errors import InputError, note
from fabdesign.formats.csv_table import write_rows
from fabdesign.formats.lab_table import LabTable


@dataclass(frozen=True)
class MembraneCurve:
    """Sampled tension per width [N/m] over engineering strain, for direction 1 (across), 2 (down) or both."""

    strain: tuple[tuple[float, ...], tuple[float, ...]]  # per direction, rising; empty: the linear stiffness holds
    tension: tuple[tuple[float, ...], tuple[float, ...]]  # N/m


COLUMNS = ["strain", "tension_n_per_m", "direction"]
_STRETCH = 0.9  # a first strain from here on is a stretch
_MOST = 5.0  # strain, more than any cloth bears


def read_membrane_curve(path: Path) -> MembraneCurve:
    """Read a membrane curve. `direction` is 1 (across), 2 (down) or `both`; without that column the curve holds for
    both. Raises InputError for another header, and unless strain and tension both rise from row to row."""
    table = LabTable(path, ",".join(COLUMNS))
    columns = [table.find("strain"), table.find("tension")]
    place = next((i for i, heading in enumerate(table.headings) if heading.name == "direction"), None)
    if place is None and len(table.header) > 2:
        raise table.bad("direction is the third column")
    table.say(COLUMNS if place is not None else COLUMNS[:2])
    strain: tuple[list[float], list[float]] = ([], [])
    tension: tuple[list[float], list[float]] = ([], [])
    for (line, row), *cells in zip(table.rows, *map(table.cells, columns), strict=True):
        name = row[place] if place is not None else "both"
        if name not in ("1", "2", "both"):
            raise InputError(f"{path} line {line}: direction = {name!r}; expected 1 (across), 2 (down) or both")
        values = [float(value) for _, _, value in cells]
        if values[0] > _MOST:
            raise InputError(
                f"{path} line {line}: strain = {values[0]:g}; expected at most {_MOST:g} (strain [%] is a percentage)"
            )
        for direction in (0, 1) if name == "both" else (int(name) - 1,):
            for column, samples, value in zip(COLUMNS, (strain, tension), values, strict=False):
                if samples[direction] and value <= samples[direction][-1]:
                    raise InputError(f"{path} line {line}: {column} = {value:g} does not rise from the row before")
                samples[direction].append(value)
    if (first := max((rows[0] for rows in strain if rows), default=0.0)) >= _STRETCH:
        note(f"{path}: its strain begins at {first:g}; expected about 0 (is it the stretch, l / l0?)")
    for direction in (0, 1):
        if len(strain[direction]) == 1:
            raise InputError(f"{path}: direction {direction + 1} has one row; a curve needs at least two")
    return MembraneCurve((tuple(strain[0]), tuple(strain[1])), (tuple(tension[0]), tuple(tension[1])))


def write_membrane_curve(curve: MembraneCurve, path: Path) -> None:
    """Write a membrane curve; reading it gives the same one."""
    rows = [
        (repr(strain), repr(tension), direction + 1)
        for direction in (0, 1)
        for strain, tension in zip(curve.strain[direction], curve.tension[direction], strict=True)
    ]
    write_rows(path, COLUMNS, rows)
