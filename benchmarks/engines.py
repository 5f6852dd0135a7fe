"""How far factors are off because another engine made the data, by sets whose true factors are known.

    python -m benchmarks.engines MODEL.toml KEY.toml [MODEL.toml KEY.toml ...]

MODEL: what `fabdesign trace SET` wrote, KEY: of the same set (data/rig_*/key.toml: a third engine, neither the
simulator nor the virtual rig). Says how many true factors are inside the 90 % intervals as they are, and inside those
that the other sets' errors give; writes the column `keyed` of studies/fitting/engine_difference.csv, whose other
column, of the virtual rig, `benchmarks/coverage.py engine` writes. `calibrate` and `trace` take the larger.
"""

import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fabdesign.files.model_file import read_model
from fabdesign.formats.csv_table import write_rows
from fabdesign.nouns.forward import PARAMETERS
from fabdesign.nouns.model import NORMAL90, Model
from studies.fitting.fitted_model import FILE, data_share, engine_columns, engine_difference

_ROUNDS = 50  # of taking the engines' term out of an interval
_SMALLEST = 1e-4  # of a logarithm


@dataclass(frozen=True, eq=False)
class Keyed:
    """Of one set, (7,) logarithms each: error of the middle of the interval, its standard deviation, and that without
    the engines' term."""

    name: str
    error: np.ndarray
    total: np.ndarray
    deviation: np.ndarray

    @staticmethod
    def read(model: Path, key: Path) -> "Keyed":
        truth, fitted = true_factors(key), read_model(model)
        ends = np.log([_interval(fitted, name) for name in PARAMETERS])
        total = np.ptp(ends, axis=1) / 2 / NORMAL90
        deviation, engines = total, engine_difference()
        for _ in range(_ROUNDS):
            taken = np.square(total) - np.square(data_share(deviation) * engines)
            deviation = np.sqrt(np.maximum(taken, _SMALLEST**2))
        return Keyed(key.parent.name, ends.mean(axis=1) - truth, total, deviation)

    def inside(self, term: np.ndarray | None = None) -> int:
        """True factors inside the intervals as they are, or with another term of the engines (7,)."""
        wide = self.total if term is None else np.hypot(self.deviation, data_share(self.deviation) * term)
        return int((np.abs(self.error) <= NORMAL90 * wide).sum())


def _interval(model: Model, name: str) -> tuple[float, float]:
    between = model.parameters[name].interval90
    assert between is not None
    return between


def true_factors(key: Path) -> np.ndarray:
    """(7,) logarithms. A key has the stiffness across where the cloth is orthotropic; ours is the geometric mean."""
    text = key.read_text(encoding="utf-8")
    factors = {name: float(value) for name, value in tomllib.loads(text)["parameters"].items()}
    for line in text.splitlines():
        if "geometric means of both directions: times" in line:
            times = float(line.partition("times ")[2].partition(")")[0])
            factors["membrane"], factors["bending"] = factors["membrane"] * times, factors["bending"] * times
    return np.log([factors[name] for name in PARAMETERS])


def term_of(sets: list[Keyed]) -> np.ndarray:
    """(7,) what the errors' mean square has over the intervals' own variance, as a standard deviation."""
    beyond = np.mean([np.square(one.error) - np.square(one.deviation) for one in sets], axis=0)
    return np.sqrt(np.maximum(beyond, 0.0) / np.mean([np.square(data_share(one.deviation)) for one in sets], axis=0))


def write_column(engine: str, term: np.ndarray) -> None:
    """Replace an engine's column (7,) of standard deviations in the file."""
    columns = engine_columns() | {engine: dict(zip(PARAMETERS, np.round(term, 4).tolist(), strict=True))}
    write_rows(
        FILE, ("parameter", *columns), [(name, *(column[name] for column in columns.values())) for name in PARAMETERS]
    )


def main() -> None:
    paths = [Path(argument) for argument in sys.argv[1:]]
    sets = [Keyed.read(*pair) for pair in zip(paths[::2], paths[1::2], strict=True)]
    virtual = np.array([engine_columns()["virtual_rig"][name] for name in PARAMETERS])
    for one in sets:
        others = np.maximum(term_of([other for other in sets if other is not one]), virtual)
        print(f"{one.name}: {one.inside()} of 7 inside; by the other sets' term {one.inside(others)}")
    write_column("keyed", term_of(sets))
    print(dict(zip(PARAMETERS, np.round(engine_difference(), 4).tolist(), strict=True)))


if __name__ == "__main__":
    main()
