"""Calibrate a bench, or the two strips of a cloth."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fabdesign.cli.console import print_result
from fabdesign.cli.progress import described

if TYPE_CHECKING:
    from studies.benches.calibrate import BenchCalibration


def calibrate_benches(
    sources: Sequence[Path], output: Path, *, fit: str | None, free: str | None, force: bool, as_json: bool
) -> None:
    """Fit each bench and print what came out; write one file, of several strips a cloth."""
    from fabdesign.bench_file import read_bench
    from fabdesign.output import new_files
    from studies.benches.calibrate import calibrate_bench, next_step
    from studies.benches.write import require_one_cloth, write_bench_type, write_cloth

    if len(sources) > 1:
        require_one_cloth([read_bench(source) for source in sources])
    with new_files(output, force=force, inputs=sources) as unfinished:
        with described("calibrating") as shown:
            fitted = [
                calibrate_bench(
                    source,
                    fit=None if fit is None else fit.split(","),
                    free=free.split(",") if free else (),
                    progress=shown,
                )
                for source in sources
            ]
        written = write_cloth(fitted, unfinished) if len(fitted) > 1 else write_bench_type(fitted[0], unfinished)
        files = [str(output.with_name(file.name)) for file in written]
    results = [_as_json(one) for one in fitted]
    result = results[0] if len(results) == 1 else {"benches": results}
    lines = [line for one in fitted for line in _lines(one, files[0])]
    print_result(result | {"files": files}, "\n".join([*lines, f"next: {next_step(fitted[0], output)}"]), as_json)


def _as_json(fitted: "BenchCalibration") -> dict[str, Any]:
    from fabdesign.encoder import plain

    return {
        "bench": fitted.bench.name,
        "unit": fitted.unit,
        "error_fit": fitted.error_fit,
        "error_left_out": fitted.error_left_out,
        "error_test": fitted.error_test,
        "error_as_fitted": fitted.error_as_fitted,
        "noise_floor": fitted.noise.sigma,
        "noise_from": fitted.noise.source,
        "constants": {name: {"value": c.value, "unit": c.unit} for name, c in fitted.constants.items()},
        "effects": [plain(effect) for effect in fitted.effects],
    }


def _lines(fitted: "BenchCalibration", file: str) -> list[str]:
    from studies.benches.calibrate import effects_in_words, errors_in_words, noise_in_words

    first = f"{file}: {fitted.bench.name}, {errors_in_words(fitted)}"
    return [first, *noise_in_words(fitted), *effects_in_words(fitted)]
