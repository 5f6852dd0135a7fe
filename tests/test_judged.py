"""Unjudged stretches: where small changes to either side lead elsewhere."""

import dataclasses

import numpy as np
import pytest
from sheets import rolled_sheet
from test_calibrate import write

from studies.judged import Stretch, elsewhere, judged, said, share_unjudged, unjudged

TIMES = np.arange(1, 31) * 0.05


class Buckler:
    """Curls one way; where all channels have over 250 kPa it buckles to either side, by gravity's sign and the first
    channel's excess, until it is 1 s old."""

    def motions(self, cases, times):
        return [self._motion(case, t) for case, t in zip(cases, times, strict=True)]

    def _motion(self, case, times):
        pressure = case.program.at(np.zeros(1))[0]
        tilt = next((term.values["about_x"] for term in case.effects), 0.0)
        curl = pressure.max() / 100e3 * case.factors["muscle_gain"] / case.factors["bending"]
        frames = []
        for t in times:
            toss = pressure.min() > 250e3 and 0.3 < t < 1.0
            frames.append(rolled_sheet((np.sign(tilt + 1e-9) if toss else 1.0) * curl + 0.1 * tilt, n=9))
        return np.stack(frames).astype(np.float32)


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    return write(tmp_path_factory.mktemp("set"), [100, 200, 300], forward=None, times=TIMES).trials


def test_only_the_stretch_in_which_either_way_is_a_coins_toss_is_unjudged(trials):
    told = []
    found = unjudged(trials, Buckler(), progress=lambda done, total: told.append((done, total)))
    assert [s.trial for s in found] == ["002"]
    assert found[0].begin == pytest.approx(0.3, abs=0.11)
    assert found[0].end == pytest.approx(1.0, abs=0.11)
    assert told[-1] == (36, 36)
    assert share_unjudged(found, trials) == pytest.approx(0.7 / 1.5 / 3, abs=0.07)
    assert "002 0." in said(found, trials)


def test_an_until_is_looked_at_no_further(trials):
    assert unjudged(trials, Buckler(), until=0.25) == ()


def test_a_motion_that_diverges_is_not_judged():
    middle = np.zeros((2, 9, 3))
    lost = middle.copy()
    lost[1] = np.nan
    assert elsewhere(middle, middle, lost).tolist() == [False, True]


def test_a_large_change_in_proportion_is_judged_until_it_is_many_times_the_usual():
    middle = np.zeros((1, 9, 3))
    assert not elsewhere(middle, middle + 0.5e-3, middle - 0.5e-3).any()
    assert elsewhere(middle, middle + 2e-3, middle - 2e-3).all()
    assert elsewhere(middle, middle + 1.5e-3, middle).all()  # to one side only


def test_frames_within_a_stretch_are_not_judged():
    stretches = (Stretch("a", 0.2, 0.4),)
    assert judged(stretches, "a", np.array([0.1, 0.2, 0.3, 0.4, 0.5])).tolist() == [True, False, False, False, True]
    assert judged(stretches, "b", np.array([0.3])).all()
    assert dataclasses.asdict(stretches[0])["begin"] == stretches[0].as_json()["from_s"] == 0.2
