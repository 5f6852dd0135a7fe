"""The files that `calibrate BENCH` writes: a muscle type or a cloth that a design can include, or a law alone."""

from collections.abc import Sequence
from pathlib import Path

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
    """Write what strips of one cloth (`require_one_cloth`) say, as `write_bench_type` writes one."""
    across, down = (_curve(strip) for strip in sorted(strips, key=lambda strip: strip.bench.constants["direction"]))
    curve = MembraneCurve((across.strain[0], down.strain[1]), (across.tension[0], down.tension[1]))
    origin = "; ".join(origin_of(strip.bench) for strip in strips)
    return _write_curve(curve, origin, output)


def write_bench_type(calibration: BenchCalibration, output: Path) -> list[Path]:
    """Write `output` (TYPE.toml) and the table it names beside it, TYPE_law.csv; the files written.

    A muscle becomes [muscle_types.NAME], with the sizes that the bench states as constants (outer_diameter,
    mass_per_length, axis_offset), and [[effects]] that were fitted and belong to it; a strip whose width is stated a
    [fabric] with its membrane_curve, in the `direction` (1 across, 2 down) that is stated or both. A design takes
    either by `include`. Anything else becomes a file of the law alone (`fabdesign.bench-law/1`). Raises InputError for
    a missing size and where `output` cannot be written.
    """
    bench, law = calibration.bench, calibration.law
    require_sizes(bench)
    table = _table_of(output)
    if isinstance(law, BenchMuscle):
        document = tomlkit.document()
        document.add(tomlkit.comment(origin_of(bench)))
        document["format"] = "fabdesign.design/1"
        entry = tomlkit.table()
        for key in SIZES:
            entry[key] = bench.constant(key)
        if law.viscosity is not None:
            entry["viscosity"] = law.viscosity
        entry["bench"] = table.name
        document["muscle_types"] = {bench.name: entry}
        if travelling := [effect for effect in calibration.effects if travels(effect)]:
            document["effects"] = [Encoder().encode(effect) for effect in travelling]
        write_bench_table(law.table(), table)
        write_text(output, tomlkit.dumps(document))
        return [output, table]
    if isinstance(law, StripLaw) and "width" in bench.constants:
        return _write_curve(_curve(calibration), origin_of(bench), output)
    write_bench_law(law.file(bench), output, table, comment=origin_of(bench))
    return [output, table]


def _curve(strip: BenchCalibration) -> MembraneCurve:
    """Return the curve of a strip whose width is stated, in its direction or both."""
    bench, law = strip.bench, strip.law
    assert isinstance(law, StripLaw)
    direction = bench.constants.get("direction")
    return law.membrane_curve(bench.constant("width"), across=direction != 2, down=direction != 1)


def _write_curve(curve: MembraneCurve, origin: str, output: Path) -> list[Path]:
    table = _table_of(output)
    document = tomlkit.document()
    document.add(tomlkit.comment(origin))
    document["format"] = "fabdesign.design/1"
    document["fabric"] = {"membrane_curve": table.name}
    write_membrane_curve(curve, table)
    write_text(output, tomlkit.dumps(document))
    return [output, table]


def _table_of(output: Path) -> Path:
    """Return the place of its table: no design's own table has that name, so none changes with it unasked."""
    return output.with_name(f"{output.stem}_law.csv")


def origin_of(bench: Bench) -> str:
    source = bench.source or bench.description
    return f"fitted to the bench {bench.name}{source and f': {source}'}"
