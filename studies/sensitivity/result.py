"""The result of a sweep: Morris' and Sobol's measures from computed samples, with bootstrap intervals.

scipy.stats.sobol_indices has the same Sobol estimators (the tests compare), but only for complete designs of 2^k rows:
here rows with a failed sample are left out, and a sweep may end early. SALib has the same too, but no input both alone
and in a group, and it would bring pandas and multiprocess."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from fabdesign.errors import InputError, SimulationError
from fabdesign.formats.json_file import plain
from fabdesign.formats.result_tables import Columns, Tabled, by_name
from fabdesign.nouns.array import Array
from fabdesign.study_files.sensitivity_file import SensitivityStudy
from studies.prediction.stability import snaps
from studies.sensitivity.variables import STEP, Inputs, OutputColumn

RESAMPLES = 500
INTERVAL = 5.0, 95.0  # percentiles of a 90 % interval


Measures = dict[str, Array]  # (n,) each by its key in result.json, intervals (n, 2)


def screening(paths: Array, values: Array, *, seed: int = 0) -> Measures:
    """Return Morris' measures by two trajectories or more (count, inputs + 1, inputs) and their outputs (count,
    inputs + 1), all finite. Of elementary effects, changes of the output over an input's whole range: mu_star, mean of
    their absolute values (Campolongo et al. 2007), its interval, mu, their mean, and sigma, their standard deviation:
    from interactions and curvature."""
    steps = np.diff(paths, axis=1)
    moved = np.abs(steps).argmax(axis=2)  # (count, inputs): which input
    sign = np.sign(np.take_along_axis(steps, moved[..., None], axis=2)[..., 0])
    effects = np.empty(moved.shape)
    np.put_along_axis(effects, moved, np.diff(values, axis=1) * sign / STEP, axis=1)
    size = np.abs(effects)
    resampled = np.array([size[pick].mean(axis=0) for pick in _picks(len(size), seed)])
    return {
        "mu_star": size.mean(axis=0),
        "interval90": _interval(resampled),
        "mu": effects.mean(axis=0),
        "sigma": effects.std(axis=0, ddof=1),
    }


def indices(values: Array, *, seed: int = 0) -> Measures:
    """Return Sobol indices, shares of the output's variance, and their intervals by the outputs (rows, 2 + groups) of
    `saltelli_rows`, all finite and not all equal."""
    resampled = np.array([_indices(values[pick]) for pick in _picks(len(values), seed)])
    (first, total), (first90, total90) = _indices(values), map(_interval, np.moveaxis(resampled, 1, 0))
    return {"first": first, "first_interval90": first90, "total": total, "total_interval90": total90}


def _indices(values: Array) -> tuple[Array, Array]:
    """Return the first order by Saltelli et al. 2010, total by Jansen 1999 (their table 2, b and f)."""
    centred = values - values[:, :2].mean()
    a, b, mixed = centred[:, :1], centred[:, 1:2], centred[:, 2:]
    variance = max(float(centred[:, :2].var()), np.finfo(float).tiny)
    return np.mean(b * (mixed - a), axis=0) / variance, 0.5 * np.mean((a - mixed) ** 2, axis=0) / variance


def _picks(count: int, seed: int) -> NDArray[np.int_]:
    return np.random.default_rng([seed, 3]).integers(count, size=(RESAMPLES, count))


def _interval(resampled: Array) -> Array:
    return np.percentile(resampled, INTERVAL, axis=0).T


FEWEST = {"morris": 4, "sobol": 8}  # whole rows or trajectories under which nothing is said
WIDE = 0.4  # of an output's variance: a wider interval of a Sobol index ranks nothing
ROWS = {"morris": "trajectories", "sobol": "rows"}
MANY_SNAP = 0.05  # share of samples that snap above which indices depend partly on chance


@dataclass(frozen=True, eq=False)
class Computed:
    """A method's design and what came of it.

    cube (rows, samples a row, inputs); values alike, in the inputs' units; outputs (whole rows, samples a row,
    columns), NaN where a sample failed: fewer rows where the time ended.
    """

    cube: Array
    values: Array
    outputs: Array

    @property
    def failed(self) -> int:
        """Return samples without a value."""
        return int(np.isnan(self.outputs).any(axis=2).sum())

    @cached_property
    def sound(self) -> NDArray[np.bool_]:
        """Return (whole rows,) whether none of its samples failed."""
        return np.asarray(~np.isnan(self.outputs).any(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class SensitivityResult(Tabled):
    """computed: by method. moves (n, 2) m: of the samples that were looked at, how far pressures 2 % off move them
    (`moves` of prediction/stability.py)."""

    study: SensitivityStudy
    inputs: Inputs
    watched: list[OutputColumn]
    computed: Mapping[str, Computed]
    moves: Array
    complete: bool
    wall_s: float
    cpu_s: float
    interrupted: bool = False  # by Ctrl-C
    json_keys: ClassVar = (
        "outputs", ("inputs", lambda of: dict(zip(of.inputs.names, of.inputs.units, strict=True))),
        ("samples.computed", "samples"), ("samples.failed", "failed"),
        ("samples.**", lambda of: {f"{m}_left_out": int((~f.sound).sum()) for m, f in of.computed.items()}),
        ("samples.looked_at", lambda of: len(of.moves)), ("samples.snapping", "snapping"),
        ("said", "sentences"), "complete", "study.points_per_side", "wall_s", "cpu_s", "study.seed",
    )  # fmt: skip

    def __post_init__(self) -> None:
        for method, samples in self.computed.items():
            if samples.sound.sum() < FEWEST[method]:
                rows = f"{samples.sound.sum()} of {len(samples.cube)} {ROWS[method]} are whole"
                why = f"{samples.failed} samples failed" if samples.failed else "the time was too short"
                raise SimulationError(f"{self.study.name}: {rows}, {why}; expected at least {FEWEST[method]}")

    @cached_property
    def measures(self) -> dict[str, list[Measures]]:
        """Return by method what it measures of each column, of its sound rows; nothing of one that does not vary."""
        return {
            method: [self._measured(method, k, column.least) for k, column in enumerate(self.watched)]
            for method in self.computed
        }

    def _measured(self, method: str, k: int, least: float) -> Measures:
        samples = self.computed[method]
        outputs = samples.outputs[samples.sound][..., k]
        if np.std(outputs[:, : 2 if method == "sobol" else None]) < least:
            return {}
        if method == "sobol":
            return indices(outputs, seed=self.study.seed)
        return screening(samples.cube[: len(samples.outputs)][samples.sound], outputs, seed=self.study.seed)

    @property
    def samples(self) -> int:
        return sum(part.outputs.shape[0] * part.outputs.shape[1] for part in self.computed.values())

    @property
    def failed(self) -> int:
        return sum(part.failed for part in self.computed.values())

    @property
    def snapping(self) -> int:
        return int(snaps(self.moves).sum())

    @property
    def sentences(self) -> list[str]:
        """Return what must be said beside the indices: warnings first, then what is in order."""
        return [text for text, _ in sorted(self._statements(), key=lambda statement: not statement[1])]

    @property
    def warnings(self) -> list[str]:
        """Return those sentences that limit what the indices say."""
        return [text for text, warns in self._statements() if warns]

    def _statements(self) -> list[tuple[str, bool]]:
        """Return sentences, and whether each is a warning."""
        texts = []
        if not self.complete:
            done = ", ".join(f"{len(f.outputs)} of {len(f.cube)} {ROWS[m]}" for m, f in self.computed.items())
            if self.interrupted:
                texts.append((f"Interrupted, with {done}; the same study goes on in its folder.", True))
            else:
                limit = self.study.seconds
                texts.append((f"Ended by its limit of {limit:g} s, with {done}; with more seconds it goes on.", True))
        if self.failed:
            rows = ", ".join(f"{(~f.sound).sum()} {ROWS[m]}" for m, f in self.computed.items() if f.failed)
            texts.append((f"{self.failed} of {self.samples} samples failed; {rows} were left out with them.", True))
        if len(self.moves):
            low, high = binomtest(self.snapping, len(self.moves)).proportion_ci(0.9, method="wilson")
            share = f"90 % interval of the share: {low:.0%} to {high:.0%}"
            snap = f"{self.snapping} of {len(self.moves)} checked samples snap: pressures 2 % off lead to another "
            snap += f"stable shape ({share})."
            many = self.snapping > MANY_SNAP * len(self.moves)
            texts.append((snap + " So the indices depend partly on chance." * many, many))
        still = [c.name for c, *each in zip(self.watched, *self.measures.values(), strict=True) if not any(each)]
        if still:
            texts.append((f"No varied parameter changes {', '.join(still)}.", False))
        ends = [of["total_interval90"] for of in self.measures.get("sobol", ()) if of]
        widest = max((float(np.ptp(each, axis=1).max()) for each in ends), default=0.0)
        if widest > WIDE:
            count = len(self.computed["sobol"].outputs)
            wide = f"The 90 % intervals of total Sobol indices are up to {widest:.2g} wide: {count} rows are too few "
            texts.append((wide + "to rank parameters by them; more `samples` narrow them.", True))
        return texts

    def indices(self, output: str) -> dict[str, dict[str, Any]]:
        """Return first, total and their intervals of an output, by parameter. Raises InputError where there are
        none."""
        entry = self.outputs.get(output, {})
        if "sobol" not in entry:
            known = ", ".join(column.name for column in self.watched)
            raise InputError(f"{output}: no indices; expected an output that varies, of {known}")
        return dict(entry["sobol"])

    def columns(self) -> Columns:
        """Return a row an output and parameter: method, and each of its numbers."""
        return by_name(
            [
                {"output": output, "unit": entry["unit"], "parameter": name, "method": method} | _flat(numbers)
                for output, entry in self.outputs.items()
                for method in self.measures
                for name, numbers in entry.get(method, {}).items()
            ]
        )

    @cached_property
    def outputs(self) -> dict[str, dict[str, Any]]:
        """Return the unit of each output, its mean, standard deviation and 90 % interval, and its measures by
        parameter."""
        return {column.name: self._output(k) for k, column in enumerate(self.watched)}

    def _output(self, k: int) -> dict[str, Any]:
        samples = self.computed.get("sobol") or self.computed["morris"]
        sound = samples.outputs[samples.sound][..., k]
        values = sound[:, :2] if "sobol" in self.computed else sound[:, 0]  # those that are independent
        low, high = np.percentile(values, INTERVAL).tolist()
        entry: dict[str, Any] = {"unit": self.watched[k].unit, "mean": float(values.mean())}
        entry |= {"std": float(values.std()), "low90": low, "high90": high}
        names = {"morris": self.inputs.names, "sobol": self.inputs.groups}
        for method, each in self.measures.items():
            if columns := plain(each[k]):
                rows = zip(*columns.values(), strict=True)
                entry[method] = {
                    name: dict(zip(columns, row, strict=True)) for name, row in zip(names[method], rows, strict=True)
                }
        return entry


def _flat(numbers: Mapping[str, Any]) -> dict[str, float]:
    """Return the ends of intervals as numbers of their own."""
    flat: dict[str, float] = {}
    for name, value in numbers.items():
        if isinstance(value, Sequence):
            stem = name.removesuffix("interval90").removesuffix("_")
            flat |= {f"{stem}{'_' * bool(stem)}{side}90": x for side, x in zip(("low", "high"), value, strict=True)}
        else:
            flat[name] = value
    return flat
