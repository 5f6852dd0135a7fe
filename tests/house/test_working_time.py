"""Compiling and loading is nobody's time."""

from pathlib import Path

import numpy as np
import pytest

from fabdesign.files.pressure_file import constant_program
from fabdesign.interface.motions import LANES as OF_MOTIONS
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.runtime import working_time
from fabdesign.runtime.working_time import Stopwatch
from fabdesign.study_files.study_file import Study, StudyLimits
from fabdesign.study_files.study_targets import TargetFile
from sim.kernels.frontend import sizes_in_words
from sim.loading import SIZES
from studies.layouts.run import run_study
from studies.prediction.prepare import LANES, PARTS
from tests.analytic_cloth import AnalyticCloth


class Clock:
    now = 0.0

    def monotonic(self) -> float:
        return self.now


def test_a_stopped_watch_stands_still_until_the_last_stop_is_undone() -> None:
    clock = Clock()
    watch = Stopwatch(clock.monotonic)
    clock.now = 3.0
    watch.stop()
    clock.now = 13.0
    watch.stop()
    clock.now = 20.0
    watch.go()
    clock.now = 43.0
    assert (watch.seconds(), watch.excluded) == (3.0, 40.0)
    watch.go()
    clock.now = 45.0
    assert (watch.seconds(), watch.excluded) == (5.0, 40.0)


def test_numba_stops_the_clock_while_it_compiles() -> None:
    from numba import njit

    working_time.watch_numba()
    before, begun = working_time.wall.excluded, working_time.seconds()

    @njit
    def shifted(x: float) -> float:
        return x + 1.0

    assert shifted(1.0) == 2.0
    compiled = working_time.wall.excluded - before
    assert compiled > 0.01
    assert working_time.seconds() - begun < compiled


class CompilesFirst(AnalyticCloth):
    """Its first batch takes `compiles` s more of a clock, for a kernel that is not compiled yet."""

    def __init__(self, clock: Clock, compiles: float) -> None:
        super().__init__(21)
        self._clock, self._compiles = clock, compiles

    def equilibria(self, cases: list[Case]) -> list[np.ndarray]:
        if self._compiles:
            with working_time.not_counted():
                self._clock.now += self._compiles
            self._compiles = 0.0
        self._clock.now += 0.125 * len(cases)
        return super().equilibria(cases)


def test_a_search_is_the_same_whether_its_kernels_are_compiled_or_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compilation takes ten times the search's seconds."""
    design = build("vertical")
    shape = AnalyticCloth().equilibria([Case(design, constant_program([300e3, 0, 200e3]))])[0]
    np.savetxt(tmp_path / "target.xyz", shape[::8])
    study = Study(
        "s", design, (TargetFile(tmp_path / "target.xyz"),), limits=StudyLimits(seconds=30.0, evaluations=100)
    )
    results = []
    for name, compiles in (("full", 0.0), ("empty", 300.0)):
        clock = Clock()
        watch = Stopwatch(clock.monotonic)
        monkeypatch.setattr(working_time, "wall", watch)
        results.append(run_study(study, tmp_path / name, forward=CompilesFirst(clock, compiles)))
        assert watch.excluded == compiles
    full, empty = results
    assert full.history == empty.history and len(full.history) > 32
    assert full.pressures.tobytes() == empty.pressures.tobytes() and full.points.tobytes() == empty.points.tobytes()
    assert (full.wall_s, full.stop_reason) == (empty.wall_s, empty.stop_reason)


def test_a_compilation_says_for_which_designs_it_serves() -> None:
    assert sizes_in_words((43 * 43, 256, 44, 4, 8)) == "grids up to 41 points a side, designs up to 256 fixed points"
    assert sizes_in_words((43 * 43, 96, 44, 4, 2)).endswith("designs up to 96 fixed points, 2 at once")
    assert SIZES[0] == (43, 96)  # what `fabdesign prepare` says that it compiles for
    [lone] = LANES.values()
    assert {*LANES} < {*PARTS} and lone == {"FABDESIGN_LANES": OF_MOTIONS}  # as `simulate` runs a lone design
