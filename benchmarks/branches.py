"""Trials that lie on another branch: what is left of rig_a if the start may be tilted or curled a little.

    python -m benchmarks.branches SET [--model MODEL] [--design NAME ...] [--grid N]

Each trial is simulated as the model says and with small changes of the frame's tilt and the cloth's natural curvature,
which decide the side that a cloth buckles to. The branch is then a hidden state of the trial: the nearest motion is
judged beside the model's own. Prints a table by design; on synthetic rigs unless the set says otherwise.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.forward import Case, Term
from fabdesign.measurement_set import read_set
from fabdesign.metrics import surface_rms
from fabdesign.model_file import read_model
from fabdesign.predictor import Predictor
from fabdesign.trial import Trial
from fabdesign.units import in_mm
from sim import Simulator

TILTS = (-2.0, -1.0, 1.0, 2.0)  # deg, about the upper edge
CURLS = (-0.6, -0.3, 0.3, 0.6)  # 1/m, down, beside the model's own
EVERY = 5  # frames
FAR = 3e-3  # m, surface RMS of a trial that no small error explains
HALF = 0.5  # of the error: at most so much is left where the trial is on the other branch
_AT_ONCE = 8  # trials


@dataclass(frozen=True)
class Branches:
    """Surface RMS [m] of a trial: of the model's own motion, and of each changed one in the order of `starts`."""

    trial: Trial
    own: float
    others: NDArray[np.float64]

    @property
    def elsewhere(self) -> bool:
        """Whether a changed start leads to a motion that is much nearer."""
        return self.own > FAR and float(np.nanmin(self.others)) < HALF * self.own

    @property
    def odds(self) -> float:
        """Share of the starts, the model's own among them, that lead as near as the nearest, within 1 mm."""
        every = np.append(self.others, self.own)
        return float(np.mean(every < np.nanmin(every) + 1e-3))


def starts() -> list[tuple[Term, ...]]:
    """What is added to a case: first nothing, then each change."""
    tilts = [(Term("frame_tilt", {"about_x": value}),) for value in TILTS]
    curls = [(Term("rest_curvature", {"down": value}),) for value in CURLS]
    return [(), *tilts, *curls]


def branches_of(trials: Sequence[Trial], forward: Predictor) -> Iterator[Branches]:
    """Of each trial. A curvature of the case takes the place of the model's own, which is added to it."""
    own = next((t.values.get("down", 0.0) for t in forward.model.terms if t.name == "rest_curvature"), 0.0)
    for first in range(0, len(trials), _AT_ONCE):
        some = trials[first : first + _AT_ONCE]
        motions = forward.motions(
            [Case(t.design, t.program, {}, _beside(added, own), t.order) for added in starts() for t in some],
            [t.times[::EVERY] for _ in starts() for t in some],
        )
        for k, trial in enumerate(some):
            errors = np.array([_error(trial, motions[k + s * len(some)]) for s in range(len(starts()))])
            yield Branches(trial, float(errors[0]), errors[1:])


def _beside(added: tuple[Term, ...], own: float) -> tuple[Term, ...]:
    return tuple(replace(t, values={k: v + own if k == "down" else v for k, v in t.values.items()}) for t in added)


def _error(trial: Trial, motion: NDArray[np.float32]) -> float:
    """m, root of the mean square over frames."""
    clouds = trial.load().frames[::EVERY]
    return _rms([surface_rms(cloud, points) for cloud, points in zip(clouds, motion, strict=True)])


def table(found: Sequence[Branches]) -> str:
    """Markdown, a row a design; mm."""
    rows = [
        "| design | trials | model alone, mm | nearest branch | over 3 mm | of those on another branch | odds there |"
    ]
    rows.append("|---|---|---|---|---|---|---|")
    for name in dict.fromkeys(b.trial.design.name for b in found):
        own = [b for b in found if b.trial.design.name == name]
        far, elsewhere = [b for b in own if b.own > FAR], [b for b in own if b.elsewhere]
        nearest = [min(b.own, float(np.nanmin(b.others))) if b.elsewhere else b.own for b in own]
        odds = f"{np.median([b.odds for b in elsewhere]):.2f}" if elsewhere else "-"
        rows.append(
            f"| {name} | {len(own)} | {in_mm(_rms([b.own for b in own])):.2f} | {in_mm(_rms(nearest)):.2f} "
            f"| {len(far)} | {len(elsewhere)} | {odds} |"
        )
    return "\n".join(rows)


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("set", type=Path)
    parser.add_argument("--model", type=Path, default=Path(str(files("fabdesign") / "data" / "demo_model.toml")))
    parser.add_argument("--design", nargs="*", default=())
    parser.add_argument("--grid", type=int, default=41)
    options = parser.parse_args()
    model = read_model(options.model).without(["corrector"])
    trials = [t for t in read_set(options.set).trials if not options.design or t.design.name in options.design]
    found = list(branches_of(trials, Predictor(Simulator(options.grid), model, sensing=True)))
    print(table(found))
    for b in found:
        if b.own > FAR:
            nearest = float(np.nanmin(b.others))
            print(f"{b.trial.name} ({b.trial.design.name}): {in_mm(b.own):.2f} mm, nearest {in_mm(nearest):.2f}")


if __name__ == "__main__":
    main()
