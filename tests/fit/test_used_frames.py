"""Sensitive stretches: where small changes to either side lead to another shape."""

import dataclasses

import numpy as np
import pytest
from sheets import rolled_sheet
from test_calibrate import write

from fabdesign.formats.json_file import plain
from studies.measured.used_frames import Stretch, find_used_frames, used_mask
from studies.prediction.stability import instants_elsewhere

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
            buckled = pressure.min() > 250e3 and 0.3 < t < 1.0
            frames.append(rolled_sheet((np.sign(tilt + 1e-9) if buckled else 1.0) * curl + 0.1 * tilt, n=9))
        return np.stack(frames).astype(np.float32)


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    return write(tmp_path_factory.mktemp("set"), [100, 200, 300], forward=None, times=TIMES).trials


def searched(trials, forward, **how):
    return find_used_frames([(None, trials)], forward, **how)


def test_only_the_stretch_that_buckles_to_either_side_is_left_out(trials):
    counts = []
    used = searched(trials, Buckler(), progress=lambda done, total: counts.append((done, total)))
    stretches = used.stretches
    assert [s.trial for s in stretches] == ["002"]
    assert stretches[0].begin == pytest.approx(0.3, abs=0.11)
    assert stretches[0].end == pytest.approx(1.0, abs=0.11)
    assert counts[0] == (18, 18)  # two draws of each trial, three motions a draw
    assert counts[-1] == (24, 24)  # two more where they part
    assert used.share_left_out == pytest.approx(0.7 / 1.5 / 3, abs=0.07)
    assert "002 0." in used.in_words


def test_the_stretches_of_a_trial_do_not_depend_on_other_trials(trials):
    [alone] = searched(trials[2:], Buckler()).stretches
    assert (alone,) == searched(trials, Buckler()).stretches


@dataclasses.dataclass(frozen=True)
class Counter(Buckler):
    """One that says what it is."""

    count: list = dataclasses.field(default_factory=list, repr=False)

    def motions(self, cases, times):
        self.count.append(len(cases))
        return super().motions(cases, times)


def test_one_search_serves_all_and_is_never_kept_in_the_set(trials, tmp_path, monkeypatch):
    monkeypatch.setenv("FABDESIGN_CACHE", str(tmp_path))
    before = sorted(trials[0].file.parents[1].rglob("*"))
    first, again = Counter(), Counter()
    stretches = searched(trials, first).stretches
    assert searched(trials, again).stretches == stretches
    assert sum(first.count) == 24 and not again.count
    assert sorted(trials[0].file.parents[1].rglob("*")) == before
    for file in tmp_path.rglob("*.json"):
        file.write_text("[[0.1")  # damaged: searched again
    assert searched(trials[2:], again).stretches == stretches and sum(again.count) == 12


def test_several_sets_stretches_are_named_by_set_and_trial(tmp_path):
    measured = write(tmp_path / "set", [100, 200, 300], forward=None, times=TIMES)
    sets = [dataclasses.replace(measured, name=name) for name in ("first", "second")]
    used = find_used_frames([(sets[0], sets[0].trials[:1]), (sets[1], sets[1].trials)], Buckler())
    [stretch] = used.stretches
    assert plain(stretch)["set"] == "second" and "second/002 0." in used.in_words
    assert used.at(sets[0], measured.trials[2]).all() and not used.at(sets[1], measured.trials[2]).all()
    assert used.share_left_out == pytest.approx(0.7 / 1.5 / 4, abs=0.05)
    assert plain(find_used_frames([(measured, measured.trials)], None)) == {"unjudged": None, "share_unjudged": 0.0}


def test_a_motion_that_diverges_is_left_out():
    middle = np.zeros((2, 9, 3))
    lost = middle.copy()
    lost[1] = np.nan
    assert instants_elsewhere(middle, middle, lost).tolist() == [False, True]


def test_a_large_change_in_proportion_is_used_until_it_is_many_times_the_usual():
    """At any scale: by the size of the motion."""
    for size in (0.01, 0.1):  # m
        middle = np.zeros((2, 9, 3))
        middle[1, :, 2] = size
        last = np.array([[[0.0]], [[1.0]]]) * size
        assert not instants_elsewhere(middle, middle + 0.09 * last, middle - 0.09 * last).any()
        assert instants_elsewhere(middle, middle + 0.11 * last, middle - 0.11 * last)[1]
        assert instants_elsewhere(middle, middle + 0.05 * last, middle)[1]  # to one side only


def test_frames_within_a_stretch_are_left_out():
    stretches = (Stretch("a", 0.2, 0.4),)
    assert used_mask(stretches, "a", np.array([0.1, 0.2, 0.3, 0.4, 0.5])).tolist() == [True, False, False, False, True]
    assert used_mask(stretches, "b", np.array([0.3])).all()
    assert dataclasses.asdict(stretches[0])["begin"] == plain(stretches[0])["from_s"] == 0.2
