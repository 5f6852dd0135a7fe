"""The paper's four layouts (Peng et al. 2022, section II) on a cloth of any size, with any number of muscles.

Margins scale with the cloth; at 0.2 m and the default counts these are the layouts that the paper measured.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from importlib.resources import as_file, files
from math import inf
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from fabdesign.errors import InputError, note
from fabdesign.files.design_file import read_design, read_part
from fabdesign.files.law_tables import read_bench_table
from fabdesign.formats.table import nearest
from fabdesign.nouns.design import Design, Term
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.muscle import Muscle, MuscleType, diameter_slip
from fabdesign.runtime.effort import CLOSEST, MUSCLES
from fabdesign.units import in_kpa, in_mm

Polyline = tuple[tuple[float, float], ...]
Laid = list[tuple[Literal["front", "back"], Polyline]]  # faces and paths of muscles

_END = 0.04  # share of the length that a straight muscle leaves free at each end, for its tubes
_CROSS = 0.075  # the same for the ends of crossed muscles
_ROUNDING = 1e-6  # m, of a path's points
_STOCK = (0.2, 0.8)  # where the outermost muscles of *vertical* lie, as shares of the width


def _spread(n: int) -> list[float]:
    """Return the middles of n equal strips."""
    return [(i + 0.5) / n for i in range(n)]


def _down(side: Literal["front", "back"], shares: list[float]) -> Laid:
    return [(side, ((u, _END), (u, 1 - _END))) for u in shares]


def _basic(n: int) -> Laid:
    return _down("front", _spread((n + 1) // 2)) + _down("back", _spread(n // 2))


def _side(n: int) -> Laid:
    return [(side, tuple((v, u) for u, v in path)) for side, path in _basic(n)]


def _cross(n: int) -> Laid:
    if n % 2:
        raise InputError(f"layout cross: muscles = {n}; expected an even number, two to a cross")
    paths: Laid = []
    for i in range(n // 2):
        left, right = (i + _CROSS) / (n // 2), (i + 1 - _CROSS) / (n // 2)
        paths.append(("front", ((left, _CROSS), (right, 1 - _CROSS))))
        paths.append(("front", ((right, _CROSS), (left, 1 - _CROSS))))
    return paths


def _vertical(n: int) -> Laid:
    first, last = _STOCK
    return _down("front", [first + (last - first) * i / (n - 1) for i in range(n)] if n > 1 else [0.5])


# name -> the faces and paths of n muscles on the unit square, and n by default
_LAYOUTS: dict[str, tuple[Callable[[int], Laid], int]] = {
    "basic": (_basic, 8),
    "side": (_side, 8),
    "cross": (_cross, 2),
    "vertical": (_vertical, 3),
}
LAYOUTS = tuple(_LAYOUTS)


@cache
def standard() -> Design:
    """Return the default cloth and muscle type, without muscles (the synthetic rigs' data sheet)."""
    with as_file(files("fabdesign") / "data") as folder:
        return read_design(folder / "standard.toml")


class Size(TypedDict, total=False):
    """The size of a cloth [m]."""

    width: float | None
    height: float | None


def build(
    layout: str,
    *,
    muscles: int | None = None,
    fabric: Fabric | None = None,
    muscle_type: MuscleType | None = None,
    fixed_point_pitch: float = 0.02,
    name: str | None = None,
    **size: Unpack[Size],
) -> Design:
    """Return a design of a catalogue layout: `basic`, `side`, `cross` or `vertical`.

    width, height: of the cloth [m]; by default those of `fabric`, which is the standard cloth.
    muscles: how many; each has a channel of its own. `basic` and `side` share them between the faces (the front has
    one more of an odd number), `cross` lays pairs side by side, `vertical` spreads them over the front.
    fixed_point_pitch: [m].
    Raises InputError for an unknown layout, a size or count out of range, and muscles closer than their diameter.
    """
    if layout not in _LAYOUTS:
        raise InputError(f"layout {layout}: expected one of {', '.join(LAYOUTS)}{nearest(layout, LAYOUTS)}")
    paths, default_count = _LAYOUTS[layout]
    count = default_count if muscles is None else muscles
    if not 1 <= count <= MUSCLES:
        raise InputError(f"layout {layout}: muscles = {count}; expected 1 to {MUSCLES}")
    if not CLOSEST <= fixed_point_pitch < inf:
        raise InputError(
            f"layout {layout}: fixed points {fixed_point_pitch:g} m apart; expected at least {CLOSEST:g} m"
        )
    given: dict[str, Any] = {side: length for side, length in size.items() if length is not None}
    cloth = replace(fabric or standard().fabric, **given)
    if not (0 < cloth.width <= 10 and 0 < cloth.height <= 10):
        raise InputError(f"layout {layout}: a cloth of {cloth.width:g} by {cloth.height:g} m; expected 0 to 10 m")
    kind = muscle_type or standard().muscle_types["EM20"]
    laid = tuple(
        Muscle(
            kind.name,
            side,
            channel,
            # a micrometre is finer than any hand sews
            tuple((round(u * cloth.width, 6), round(v * cloth.height, 6)) for u, v in path),
            fixed_point_pitch,
        )
        for channel, (side, path) in enumerate(paths(count))
    )
    _require_room(layout, laid, kind.outer_diameter)
    return Design(name or layout, cloth, {kind.name: kind}, laid)


def _require_room(layout: str, muscles: tuple[Muscle, ...], diameter: float) -> None:
    for i, a in enumerate(muscles):
        for b in muscles[i + 1 :]:
            starts = max(abs(a.path[0][0] - b.path[0][0]), abs(a.path[0][1] - b.path[0][1]))
            if a.side == b.side and starts < diameter - _ROUNDING:
                hint = diameter_slip(diameter) or ": fewer of them or a wider cloth"
                raise InputError(
                    f"layout {layout}: {len(muscles)} muscles lie {in_mm(starts):.3f} mm apart; "
                    f"expected at least their diameter, {in_mm(diameter):.3f} mm{hint}"
                )


def read_muscle_type(file: Path, name: str) -> tuple[MuscleType, tuple[Term, ...]]:
    """Return the muscle type `name` and the effects that its bench showed.

    file: a TOML with [muscle_types.NAME], as `fabdesign calibrate BENCH -o TYPE.toml` writes it, or a CSV
    pressure_kpa,contraction,force_n, whose muscle has the sizes of EM20. Raises InputError for any other.
    """
    if file.suffix.lower() == ".toml":
        part = read_part(file)
        if name not in part.types:
            known = ", ".join(part.types) or "no muscle type"
            raise InputError(f"{file}: has no muscle type {name}; it has {known}")
        return _limited(part.types[name]), part.effects
    if file.is_dir():
        raise InputError(f"{file}: a folder; expected the file that `fabdesign calibrate {file} -o TYPE.toml` writes")
    (like,) = standard().muscle_types.values()
    note(f"{file}: a table without sizes; outer_diameter, mass_per_length and axis_offset are those of {like.name}")
    bench = read_bench_table(file)
    measured = MuscleType(name, like.outer_diameter, like.mass_per_length, like.axis_offset, bench, like.viscosity)
    return _limited(measured), ()


def _limited(kind: MuscleType) -> MuscleType:
    """Return the type with the bench's highest pressure as its maximum, where it states none."""
    if kind.max_pressure is not None:
        return kind
    highest = max(kind.bench.pressure)
    note(f"{kind.name}: max_pressure is the highest on its bench, {in_kpa(highest):g} kPa")
    return replace(kind, max_pressure=highest)
