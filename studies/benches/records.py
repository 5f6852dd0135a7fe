"""The specimens that a bench may have, each with its law; what their records must hold; and the noise of readings, from
what no law makes: repeats of a record, and a reading beside its neighbours.

It never comes from what a law leaves: a law that lacks an effect leaves that too. That of clouds is estimated in
`fabdesign/geometry/sensor_noise.py`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from fabdesign.errors import InputError
from fabdesign.formats.schema import Key
from fabdesign.nouns.array import Array
from fabdesign.nouns.bench import Bench, BenchRecord, Specimen
from fabdesign.nouns.muscle import WIDEST
from fabdesign.units import in_mm
from studies.benches.actuator import StaticCurve
from studies.benches.cylinder import CylinderLaw
from studies.benches.law import Law
from studies.benches.muscle import BenchMuscle
from studies.benches.strip import StripLaw

LAWS: Mapping[Specimen, type[Law]] = {
    "muscle": BenchMuscle,
    "strip": StripLaw,
    "cylinder": CylinderLaw,
    "actuator": StaticCurve,
}
LEAST_SHOWN = 0.001  # mm or N: what no gauge reads
SIZES = ("outer_diameter", "mass_per_length", "axis_offset")  # m, kg/m, m: a muscle type has them, no bench shows them


def require_columns(bench: Bench, records: Sequence[BenchRecord]) -> None:
    """Raise InputError for a record without a column that the specimen's law is fitted to."""
    for record in records:
        for group in LAWS[bench.specimen].columns:
            if not set(group) & record.columns.keys():
                raise InputError(
                    f"{bench.file}: {record.name}: no column {' or '.join(group)}, which a {bench.specimen} needs; "
                    f"it has {', '.join(record.columns)}"
                )


def require_sizes(bench: Bench) -> None:
    """Raise InputError for a muscle bench that does not state what a muscle type needs beyond its law."""
    missing = [name for name in SIZES if name not in bench.constants]
    if bench.is_muscle and missing:
        raise InputError(
            f"{bench.file}: [constants] lack {', '.join(missing)}; expected numbers in SI units, for a muscle type"
        )
    diameter = bench.constants.get("outer_diameter", 0.0)
    if bench.is_muscle and diameter > WIDEST:
        raise InputError(
            f"{bench.file}: outer_diameter = {diameter:g}; expected at most {WIDEST:g} m (is it in millimetres?)"
        )


def for_people(unit: str) -> tuple[float, str]:
    """Return the factor on values in an SI unit that people are shown, and the unit that they see: mm for m."""
    return (in_mm(1.0), "mm") if unit == "m" else (1.0, unit)


def shown(value: float, unit: str) -> str:
    """Return a value in an SI unit, as people are shown it."""
    factor, name = for_people(unit)
    return f"{factor * value:.3g} {name}"


def output_of(bench: Bench) -> str:
    """Return the column that is compared row by row; of an actuator the displacement."""
    return LAWS[bench.specimen].output or bench.output


def laws_of(bench: Bench, records: Sequence[BenchRecord], tell: Callable[[float], None]) -> list[Array]:
    """Return (n,) what the law says of each record, fitted to the others. tell: is given the share done."""
    laws = []
    for k, record in enumerate(records):
        tell(k / len(records))
        laws.append(LAWS[bench.specimen].still([*records[:k], *records[k + 1 :]], record))
    return laws


_INPUTS = "pressure", "pressure_command", "pressure_amplitude", "contraction", "displacement", "stretch"
_SAME = 1e-3  # of an input's range: repeats differ by less
_ROWS = 7  # of a window
_STRIDES = 1, 2, 4, 8, 16  # rows from one reading of a window to the next
_LEAST_WINDOWS = 12  # of a record
_CLEAR = 0.02  # of an input's range: a step by which neighbours are compared with care
_EVEN = 0.3  # of a window's largest step, that its smallest one is
_STEADY = 1e-6  # of a column's size, what does not count as a direction of its own
_CORRELATED = 2.2  # times the variance at half the stride: noise that walks has 2, a smooth signal up to 64
_COLOURED = 1.1  # times it, above which noise is correlated
_SIGNAL = 8.0  # times it, above which the signal itself is seen


@dataclass(frozen=True)
class BenchNoise:
    """sigma: standard deviation of a reading, in the output's SI unit; 0 where the records do not show it."""

    sigma: Annotated[float, Key("noise_floor")]
    source: Annotated[Literal["repeats", "neighbours", "unknown"], Key("noise_from")]

    def in_words(self, shown: str) -> str:
        """Say where it comes from. shown: sigma with its unit."""
        if self.source == "unknown":
            return "noise unknown (steps too coarse and no repeats), so all that is left counts as error"
        return f"noise {shown}, from {'repeats' if self.source == 'repeats' else 'neighbouring readings'}"


def noise_of(bench: Bench) -> BenchNoise:
    """Return the noise of a bench's output, one for all who ask, from all of its records: by repeats where there are
    any, else by neighbours, as the median over records. A quantised output has at least the noise of its steps."""
    output, records = output_of(bench), bench.records
    readings = [record.columns[output] for record in records]
    inputs = [{n: r.columns[n] for n in _INPUTS if n in r.columns and n != output} for r in records]
    for name in set().union(*inputs):  # in its range over all records, at least a twentieth of its largest value
        together = np.concatenate([x[name] for x in inputs if name in x])
        size = max(float(np.ptp(together)), 0.05 * float(np.abs(together).max()), 1e-30)
        inputs = [x | {name: x[name] / size} if name in x else x for x in inputs]
    distinct = [(np.unique(values), len(values)) for values in readings]
    steps = [float(np.diff(values).min()) for values, count in distinct if 1 < len(values) < count / 2]
    step = max(steps, default=0.0) / np.sqrt(12)
    repeated = _by_repeats(readings, inputs)
    if repeated is not None:
        return BenchNoise(max(repeated, step), "repeats")
    single = [_by_neighbours(y, x) for y, x in zip(readings, inputs, strict=True)]
    known = [sigma for sigma in single if sigma is not None]
    return BenchNoise(max(float(np.median(known)), step), "neighbours") if known else BenchNoise(0.0, "unknown")


def _by_repeats(readings: Sequence[Array], inputs: Sequence[dict[str, Array]]) -> float | None:
    """Return the noise by what differs between records of the same inputs, row by row. A record's offset and scale are
    none: a specimen that softens has them."""
    squares, freedom, taken = 0.0, 0, set[int]()
    for k in range(len(readings)):
        same = [j for j in range(k, len(readings)) if j not in taken and _repeats(inputs[k], inputs[j])]
        taken.update(same)
        if len(same) < 2 or len(readings[k]) < 2 * _ROWS:
            continue
        rows = np.stack([readings[j] for j in same])
        mean = np.stack([np.ones(rows.shape[1]), rows.mean(axis=0)], axis=1)
        unexplained = rows - (mean @ np.linalg.lstsq(mean, rows.T, rcond=None)[0]).T
        squares += float(np.square(unexplained).sum())
        freedom += (len(same) - 1) * (rows.shape[1] - 2)
    return float(np.sqrt(squares / freedom)) if freedom >= _LEAST_WINDOWS else None


def _repeats(one: dict[str, Array], other: dict[str, Array]) -> bool:
    return one.keys() == other.keys() and all(
        len(x) == len(other[name]) and np.abs(x - other[name]).max(initial=0.0) <= _SAME for name, x in one.items()
    )


def _by_neighbours(y: Array, inputs: dict[str, Array]) -> float | None:
    """Return the noise by what windows of readings leave of a parabola and of straight lines over the inputs.

    None where that may be the signal itself, which grows steeply when the readings are taken farther apart. Noise that
    is correlated over a few readings grows slowly; then those farther apart count."""
    variances: list[float] = []
    for stride in _STRIDES:
        variance = _variance(y, inputs, stride)
        if variance is None:
            break
        variances.append(variance)
    if len(variances) < 2 or variances[1] > _SIGNAL * variances[0] > 0:
        return None
    k, growth = 0, np.diff(variances)
    while k + 1 < len(growth) and _COLOURED * variances[k] < variances[k + 1] <= _CORRELATED * variances[k]:
        if growth[k + 1] > 4 * growth[k]:  # the signal begins
            break
        k += 1
    return float(np.sqrt(variances[k]))


def _variance(y: Array, inputs: dict[str, Array], stride: int) -> float | None:
    """Return the median over windows of what the readings leave, for each degree of freedom; None for few windows."""
    from scipy.stats import chi2

    span = (_ROWS - 1) * stride + 1
    if len(y) < span:
        return None

    def windows(values: Array) -> Array:
        return np.lib.stride_tricks.sliding_window_view(values, span)[:, ::stride]

    moving = [windows(values) for values in inputs.values()]
    smooth = np.ones(len(y) - span + 1, dtype=np.bool_)  # no input turns or jumps: it stands, creeps, or goes on evenly
    for steps in (np.diff(x, axis=1) for x in moving):
        along, largest = steps * np.sign(steps.sum(axis=1, keepdims=True)), np.abs(steps).max(axis=1)
        smooth &= (largest <= _CLEAR) | (along.min(axis=1) >= _EVEN * largest)
    readings = windows(y)[smooth]
    if len(readings) < _LEAST_WINDOWS:
        return None
    place = np.linspace(-1, 1, _ROWS)
    columns = [np.broadcast_to(place**power, readings.shape) for power in range(3)]
    columns += [x[smooth] - x[smooth].mean(axis=1, keepdims=True) for x in moving]
    basis, size, _ = np.linalg.svd(np.stack(columns, axis=2), full_matrices=False)
    used = size > _STEADY * np.sqrt(_ROWS)
    level = readings.mean(axis=1, keepdims=True)
    coefficients = np.einsum("nrk,nr->nk", basis, readings - level) * used
    unexplained = np.square(readings - level).sum(axis=1) - np.square(coefficients).sum(axis=1)
    # the variance by the median of chi-square sums of several degrees of freedom
    return float(np.median(np.maximum(unexplained, 0.0) / chi2.median(_ROWS - used.sum(axis=1))))
