"""Prediction intervals against measurements: coverage, width and CRPS of 90 % intervals of a predicted motion.

    python -m benchmarks.spread SET --model M.toml [--grid N] [--most K] -o TABLE.md

Predicted is the mean height of the cloth in each of nine regions at every sixth frame, along the normal of the
predicted mid-surface. Trials: those that the model was not fitted to, at most K of a design, spread over the session.
Three widths: the joint covariance of the model alone (draws, simulated); a constant; both and a share of how far the
region has moved since rest. The last two are calibrated on the other trials, whole trials left out in turn: least CRPS,
then scaled so that 90 % of the others' residuals are inside.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import norm

from benchmarks.machine import commit
from corrector.examples import offsets
from corrector.shape import FINE, LocalFrames, middle_of
from fabdesign.forward import SIDE, Case
from fabdesign.measurement_set import read_set
from fabdesign.model import Model
from fabdesign.model_file import read_model
from fabdesign.model_sampling import drawn, joint_root
from fabdesign.output import write_text
from fabdesign.predictor import Predictor
from fabdesign.trial import MeasurementSet, Trial
from optimize.fit.clouds import evenly

Array = NDArray[np.float64]
DRAWS = 16
FIRST, EVERY = 5, 6  # frames
REGIONS = 3  # a side
INSIDE = 0.9
TWO_SIDED = float(norm.ppf(0.5 + INSIDE / 2))


@dataclass(frozen=True, eq=False)
class Judged:
    """Of one trial, (n,) each, a region at a frame."""

    design: str
    residual: Array  # m, measured less predicted
    spread: Array  # m, standard deviation over draws of the joint covariance
    moved: Array  # m since rest


def trials_of(measured: MeasurementSet, model: Model, most: int) -> list[Trial]:
    """Not fitted, spread over the session."""
    fitted = {name.rpartition("/")[2] for name in model.provenance.fitted}
    found = []
    for name in sorted({trial.design_name for trial in measured.trials}):
        own = [t for t in measured.trials if t.design_name == name and t.name not in fitted]
        found += [own[k] for k in evenly(len(own), most)]
    return found


def judged(trials: Sequence[Trial], model: Model, grid: int) -> list[Judged]:
    from sim import Simulator

    root = joint_root(model)
    rng = np.random.default_rng(0)
    models = [model, *(drawn(model, root, z) for z in rng.standard_normal((DRAWS, len(root))))]
    times = [np.concatenate([[0.0], trial.times[FIRST::EVERY]]) for trial in trials]
    cases = [Case(trial.design, trial.program, order=trial.order) for trial in trials]
    simulator = Simulator(grid)
    motions = [Predictor(simulator, each, sensing=True).motions(cases, times) for each in models]
    return [_judged(trial, *(motion[k] for motion in motions)) for k, trial in enumerate(trials)]


def _judged(trial: Trial, predicted: NDArray[np.float32], *others: NDArray[np.float32]) -> Judged:
    fabric, clouds = trial.design.fabric, trial.load().frames[FIRST::EVERY]
    middle = middle_of(predicted, SIDE)
    normal = LocalFrames.of(middle, fabric.width, fabric.height, FINE).normal
    nodes = _nodes(middle)
    pairs = [offsets(m, cloud, fabric.thickness) for m, cloud in zip(middle[1:], clouds, strict=True)]
    heights, counts = (np.array([pair[k] for pair in pairs], dtype=float) for k in (0, 1))
    off = [_nodes(middle_of(other, SIDE)) - nodes for other in others]
    along = np.array([np.einsum("tabi,tabi->tab", one, normal)[1:] for one in off])
    seen = by_region(counts) > 0
    weight = np.maximum(by_region(counts), 1e-9)
    spread = np.array([by_region(one) for one in along]).std(axis=0, ddof=1) / _share(nodes.shape[1])
    moved = np.linalg.norm(nodes[1:] - nodes[:1], axis=-1)
    return Judged(
        trial.design_name,
        (by_region(heights * counts) / weight)[seen],
        spread[seen],
        (by_region(moved) / _share(nodes.shape[1]))[seen],
    )


def _nodes(middle: NDArray[np.float32]) -> NDArray[np.float32]:
    """(T, FINE, FINE, 3) m."""
    every = (SIDE - 1) // (FINE - 1)
    return middle[:, ::every, ::every]


def by_region(values: Array) -> Array:
    """(T, REGIONS, REGIONS) sums of (T, n, n)."""
    edges = np.linspace(0, values.shape[1], REGIONS + 1).astype(int)[:-1]
    return np.add.reduceat(np.add.reduceat(values, edges, axis=1), edges, axis=2)


def _share(n: int) -> Array:
    """(REGIONS, REGIONS) nodes in each."""
    return by_region(np.ones((1, n, n)))[0]


def crps(residual: Array, sigma: Array) -> Array:
    """(n,) m, of a normal distribution about nothing (Gneiting and Raftery 2007, eq. 21)."""
    z = residual / sigma
    return np.asarray(sigma * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi)))


def constant(shape: Array, one: Judged) -> Array:
    return np.full(len(one.residual), float(np.exp(shape[0])))


def combined(shape: Array, one: Judged) -> Array:
    """Constant, what the covariance says, and a share of the motion, in quadrature."""
    least, times, share = np.exp(shape)
    return np.asarray(np.sqrt(least**2 + (times * one.spread) ** 2 + (share * one.moved) ** 2))


def calibrated(others: Sequence[Judged], width: Callable[[Array, Judged], Array], start: Array) -> tuple[Array, float]:
    """What shapes the width at least CRPS, and the factor that puts 90 % of the residuals inside."""

    def mean(shape: Array) -> float:
        return float(np.concatenate([crps(one.residual, width(shape, one)) for one in others]).mean())

    shape = minimize(mean, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-9}).x
    ratios = np.concatenate([np.abs(one.residual) / width(shape, one) for one in others])
    return shape, float(np.quantile(ratios, INSIDE)) / TWO_SIDED


def widths(every: Sequence[Judged]) -> dict[str, list[Array]]:
    """(n,) m, standard deviations by way and trial, each trial's calibrated on the others."""
    found: dict[str, list[Array]] = {"joint covariance alone": [one.spread for one in every], "constant": [], "all": []}
    ways = {"constant": (constant, np.log([1e-3])), "all": (combined, np.log([0.5e-3, 1.0, 0.01]))}
    for k, one in enumerate(every):
        others = [*every[:k], *every[k + 1 :]]
        for name, (width, start) in ways.items():
            shape, factor = calibrated(others, width, start)
            found[name].append(factor * width(shape, one))
    return found


def table(every: Sequence[Judged]) -> str:
    lines = ["| design | trials | width | inside (90 %) | mean width, mm | CRPS, mm |", "|---|---|---|---|---|---|"]
    by_way = widths(every)
    for design in [*sorted({one.design for one in every}), "all"]:
        own = [k for k, one in enumerate(every) if design in (one.design, "all")]
        residual = np.concatenate([every[k].residual for k in own])
        for name, sigmas in by_way.items():
            sigma = np.maximum(np.concatenate([sigmas[k] for k in own]), 1e-9)
            inside = float((np.abs(residual) <= TWO_SIDED * sigma).mean())
            width, score = (1e3 * float(x.mean()) for x in (2 * TWO_SIDED * sigma, crps(residual, sigma)))
            lines.append(f"| {design} | {len(own)} | {name} | {inside:.0%} | {width:.2f} | {score:.3f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--grid", type=int)
    parser.add_argument("--most", type=int, default=10, help="Trials of a design.")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    model = read_model(options.model).without(["corrector"])
    trials = trials_of(read_set(options.set), model, options.most)
    text = f"Commit {commit()}.\n\n" + table(judged(trials, model, options.grid or model.points_per_side))
    write_text(options.output, text)
    print(text)


if __name__ == "__main__":
    main()
