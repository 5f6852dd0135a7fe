"""What to cut for a design: every muscle with its length, as a CSV in millimetres."""

from pathlib import Path

from fabdesign.csv_table import write_rows
from fabdesign.design import Design
from fabdesign.errors import InputError
from fabdesign.muscle import MuscleType

COLUMNS = ["muscle", "type", "side", "channel", "laced_mm", "tail_mm", "cut_mm", "fixed_points"]


def write_cut_list(design: Design, path: Path, *, tail_length: float | None = None) -> None:
    """Write a row a muscle: its laced length, the tail at each end, the length to cut and the number of fixed points.

    tail_length: [m], in place of the muscle types' own. Raises InputError for a type in use that has none, and for a
    muscle that is longer than its type's stock.
    """
    rows = []
    for number, muscle in enumerate(design.muscles):
        kind = design.muscle_types[muscle.type]
        tail = _tail(design, kind, tail_length)
        cut = muscle.length + 2 * tail
        if kind.stock_length is not None and cut > kind.stock_length:
            raise InputError(
                f"design {design.name}: muscle {number} needs {cut * 1e3:.1f} mm; "
                f"expected at most its stock, {kind.stock_length * 1e3:g} mm of {kind.name}"
            )
        lengths = (f"{value * 1e3:.1f}" for value in (muscle.length, tail, cut))
        rows.append((number, muscle.type, muscle.side, muscle.channel, *lengths, len(muscle.fixed_points())))
    write_rows(path, COLUMNS, rows)


def _tail(design: Design, kind: MuscleType, asked: float | None) -> float:
    tail = kind.tail_length if asked is None else asked
    if tail is None:
        raise InputError(
            f"design {design.name}: muscle type {kind.name} has no tail_length, and a cut list without tails is too "
            "short; expected --tail-length, in m, what stays free at each end for tube and knot"
        )
    return tail
