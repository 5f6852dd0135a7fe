"""The bench of few motions: numbers of trials as it says, the smaller within the larger, none of them judged."""

from pathlib import Path

from benchmarks.few_motions import EIGHT, FIVE, PLANS, SIXTEEN, TEN, judged_on
from fabdesign.files.measurement_set import read_set
from studies.measured.splits import fit_trials


def test_trials_are_nested_and_none_is_judged(data: Path) -> None:
    measured = read_set(data / "rig_a")
    fitted = [{trial.name for trial in fit_trials(measured.trials, orders)} for orders in (FIVE, EIGHT, TEN, SIXTEEN)]
    assert [len(names) for names in fitted] == [5, 8, 10, 16]
    assert fitted[0] < fitted[1] < fitted[2] < fitted[3]
    judged = judged_on(measured, [plan for plan in PLANS if plan.orders in (FIVE, EIGHT, TEN, SIXTEEN)])
    assert len([trial for trial in judged if trial.design_name == "basic"]) == 11
    assert {trial.role for trial in judged if trial.design_name == "vertical"} == {"test"}
    assert not fitted[3] & {trial.name for trial in judged}
