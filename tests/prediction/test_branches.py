"""A trial whose cloth buckled to the other side than the model's is told from one that the model only misses."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from sheets import rolled_sheet

from fabdesign.files.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.trial import Trial
from studies.demo.measured import branch_in_words
from studies.prediction.stability import FAR, branches_of, starts

DESIGN = build("cross")
TIMES = np.arange(1, 7) * 0.1


class Buckles:
    """Rolls forward, or backward where the frame is tilted by more than a degree."""

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        return [
            rolled(-1.0 if any(term.values.get("about_x", 0.0) > 1.5 for term in case.effects) else 1.0, instants)
            for case, instants in zip(cases, times, strict=True)
        ]


def rolled(side: float, times: np.ndarray) -> np.ndarray:
    return np.stack([rolled_sheet(side * (0.1 + 2 * t)) for t in times]).astype(np.float32)


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Trial]:
    rng, noise = np.random.default_rng(3), SensorNoise(0.0003, 0.0, 0.05)
    pressure = np.full((len(TIMES), DESIGN.channels), 100e3)

    def trial(name: str, order: int, side: float) -> NewTrial:
        clouds = tuple(noise.draw(Surface.of_faces(frame), 300, rng) for frame in rolled(side, TIMES))
        return NewTrial(name, "cross", order, "fit", TrialData(TIMES, pressure, clouds))

    folder: Path = tmp_path_factory.mktemp("measured")
    made = [trial(name, k, side) for k, (name, side) in enumerate((("as", 1.0), ("back", -1.0), ("flat", -0.1)))]
    write_set(folder, {"cross": DESIGN}, made, name="rolls", description="synthetic")
    return {trial.name: trial for trial in read_set(folder).trials}


def test_the_other_branch_is_found_by_a_start_that_differs_a_little(trials: dict[str, Trial]) -> None:
    branches = {b.trial.name: b for b in branches_of([*trials.values()], Predictor(Buckles()), every=2)}
    assert [branches[name].on_another_branch for name in ("as", "back", "flat")] == [False, True, False]
    assert branches["back"].unchanged > FAR > 1e-3 > branches["back"].nearest
    assert branches["back"].odds == pytest.approx(1 / len(starts()))
    assert branches["flat"].unchanged > FAR  # as far off, and no start leads there


def test_it_is_said_which_it_is(trials: dict[str, Trial]) -> None:
    branches = {b.trial.name: b for b in branches_of([*trials.values()], Predictor(Buckles()))}
    assert branch_in_words(branches["back"]).startswith("It took another stable shape (branch):")
    assert branch_in_words(branches["flat"]).startswith("It is not another stable shape (branch),")
    assert f"{1e3 * branches['flat'].unchanged:.2f} mm." in branch_in_words(branches["flat"])


def test_a_start_that_diverges_leads_nowhere(trials: dict[str, Trial]) -> None:
    class Diverges(Buckles):
        def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
            motions = super().motions(cases, times)
            return [np.full_like(m, np.nan) if c.effects else m for c, m in zip(cases, motions, strict=True)]

    [branch] = branches_of([trials["back"]], Predictor(Diverges()))
    assert branch.nearest == np.inf and not branch.on_another_branch
