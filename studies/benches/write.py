"""The files that `calibrate BENCH` writes: a muscle type or a cloth that a design can include, or a law alone."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit

from fabdesign.errors import InputError
from fabdesign.files.law_tables import MembraneCurve, write_bench_law, write_bench_table, write_membrane_curve
from fabdesign.formats.codec import Encoder
from fabdesign.nouns.bench import Bench
from fabdesign.output import write_text
from studies.benches.calibrate import BenchCalibration
from studies.benches.muscle import BenchMuscle, travels
from studies.benches.records import SIZES, require_sizes
from studies.benches.strip import StripLaw

DIRECTIONS = "across", "down"  # of a strip, 1 and 2 in its file


def require_one_cloth(benches: Sequence[Bench]) -> None:
    """Raise InputError unless benches given together are strips of one cloth, one cut across and one down."""
    for bench in benches:
        where = f"{bench.file}: with another bench"
        if bench.specimen != "strip":
            raise InputError(f"{where}: the specimen is a {bench.specimen}; expected strips of one cloth, or it alone")
        if "width" not in bench.constants or bench.constants.get("direction") not in (1, 2):
            raise InputError(f"{where}: [constants] lack width or direction; expected both, direction 1 across, 2 down")
    if len(benches) > 2 or len({bench.constants["direction"] for bench in benches}) < len(benches):
        names = ", ".join(f"{b.file} {DIRECTIONS[int(b.constants['direction']) - 1]}" for b in benches)
        raise InputError(f"{names}; expected one strip across (direction = 1) and one down (direction = 2)")


def write_cloth(strips: Sequence[BenchCalibration], output: Path) -> list[Path]:
    """Write what one strip of a cloth says, or one across and one down (`require_one_cloth`), as `write_bench_type`."""
    curves = []
    for strip in sorted(strips, key=lambda strip: strip.bench.constants.get("direction", 0)):
        bench, law, direction = strip.bench, strip.law, strip.bench.constants.get("direction")
        assert isinstance(law, StripLaw)
        curves.append(law.membrane_curve(bench.constant("width"), across=direction != 2, down=direction != 1))
    across, down = curves[0], curves[-1]
    table = _table_of(output)
    write_membrane_curve(MembraneCurve((across.strain[0], down.strain[1]), (across.tension[0], down.tension[1])), table)
    _write_part({"fabric": {"membrane_curve": table.name}}, [strip.bench for strip in strips], output)
    return [output, table]


def write_bench_type(calibration: BenchCalibration, output: Path) -> list[Path]:
    """Write `output` (TYPE.toml) and the table it names beside it, TYPE_law.csv; the files written.

    A muscle becomes [muscle_types.NAME], with the sizes that the bench states as constants (outer_diameter,
    mass_per_length, axis_offset), and [[effects]] that were fitted and belong to it; a strip whose width is stated a
    [fabric] with its membrane_curve, in the `direction` (1 across, 2 down) that is stated or both. A design takes
    either by `include`. Anything else becomes a file of the law alone (`fabdesign.bench-law/1`). Raises InputError for
    a missing size and where `output` cannot be written.
    """
    bench, law, table = calibration.bench, calibration.law, _table_of(output)
    require_sizes(bench)
    if isinstance(law, StripLaw) and "width" in bench.constants:
        return write_cloth([calibration], output)
    if isinstance(law, BenchMuscle):
        entry: dict[str, Any] = {key: bench.constant(key) for key in SIZES}
        if law.viscosity is not None:
            entry["viscosity"] = law.viscosity
        entry["bench"] = table.name
        effects = [Encoder().encode(effect) for effect in calibration.effects if travels(effect)]
        write_bench_table(law.table(), table)
        content: dict[str, Any] = {"muscle_types": {bench.name: entry}}
        _write_part(content | ({"effects": effects} if effects else {}), [bench], output)
    else:
        write_bench_law(law.file(bench.output), output, table, comment=origin_of(bench))
    return [output, table]


def _write_part(content: dict[str, Any], benches: Sequence[Bench], output: Path) -> None:
    """Write what a design includes, and which benches it comes from."""
    document = tomlkit.document()
    document.add(tomlkit.comment("; ".join(map(origin_of, benches))))
    document.update({"format": "fabdesign.design/1"} | content)
    write_text(output, tomlkit.dumps(document))


def _table_of(output: Path) -> Path:
    """Return the place of its table: no design's own table has that name, so none changes with it unasked."""
    return output.with_name(f"{output.stem}_law.csv")


def origin_of(bench: Bench) -> str:
    source = bench.source or bench.description
    return f"fitted to the bench {bench.name}{source and f': {source}'}"
