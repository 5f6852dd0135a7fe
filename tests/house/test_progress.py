"""Progress: a bar with the time left on a terminal, lines elsewhere."""

import os
import pty
import subprocess
import sys

import pytest

from fabdesign.cli import console
from fabdesign.files.bench_file import read_bench
from fabdesign.runtime import effort
from fabdesign.study_files.loop_file import LoopStudy
from studies.benches.tracing import examine
from studies.loop.run import loop_in_words
from studies.model_selection.verdict import so_far
from tests.conftest import ROOT

COUNT = """
import time
from fabdesign.cli.console import described
from fabdesign.runtime.working_time import not_counted
with described("predicted") as shown:
    for done in range(1, 4):
        time.sleep(0.15)
        shown(f"predicted {done} of 4 trials", done / 4)
with described("calibrating") as told:
    told("to 0.5 s, iteration 1: 2.000 mm RMS", 0.25)
    with not_counted():
        time.sleep(0.3)
print("over")
"""
SEARCH = """
import time
from types import SimpleNamespace
from fabdesign.cli.console import described
from fabdesign.interface.searches import followed
with described("sheet", of_search=True) as shown:
    history = SimpleNamespace(evaluations=64)
    at = SimpleNamespace(stage="layouts", history=history, elapsed=20.0, seconds=60.0, share=1 / 3,
                         best_in_words="best 12.300 mm on the coarse model",
                         message="after a tenth of its time 20.00 mm")
    show = followed(SimpleNamespace(progress=shown))
    show(at, "free")
    show(SimpleNamespace(**vars(at) | {"message": ""}), "next")
    time.sleep(0.2)
"""


def on_terminal(script: str) -> str:
    """What a script writes to a terminal of 120 columns."""
    master, slave = pty.openpty()
    env = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    with subprocess.Popen([sys.executable, "-c", script], stdout=slave, stderr=slave, cwd=ROOT, env=env) as child:
        os.close(slave)
        parts = []
        while True:
            try:
                parts.append(os.read(master, 4096))
            except OSError:  # how a terminal whose writers are gone ends on Linux
                break
            if not parts[-1]:
                break
        os.close(master)
    assert child.returncode == 0
    return b"".join(parts).decode()


def test_lines_where_there_is_no_terminal():
    done = subprocess.run([sys.executable, "-c", COUNT], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout == "over\n"
    expected = [*(f"predicted {k} of 4 trials" for k in (1, 2, 3)), "to 0.5 s, iteration 1: 2.000 mm RMS"]
    assert done.stderr.splitlines() == expected


def test_a_bar_on_a_terminal():
    shown = on_terminal(COUNT)
    assert "predicted 3 of 4 trials" in shown and "━" in shown and "left" in shown
    assert "0:00:0" in shown  # s left
    assert "iteration 1: 2.000 mm RMS" in shown and "compiling the simulator" in shown
    assert shown.rstrip().endswith("over")


def test_a_search_shows_its_best_and_the_seconds_left():
    shown = on_terminal(SEARCH)
    assert "sheet: next: layouts: best 12.300 mm on the coarse model, 64 evaluations, 20 s" in shown
    assert "━" in shown and "40 s left at most" in shown
    assert "sheet: free: after a tenth of its time 20.00 mm" in shown
    assert "sheet: \r\n" not in shown and "next: \r\n" not in shown  # nothing to tell is no line


def test_an_estimate_stays_and_a_step_is_followed_by_the_time_left(monkeypatch, capsys):
    clock = iter([0.0, 0.0, 10.0, 12.0, 25.0])
    monkeypatch.setattr(console.working_time, "seconds", lambda: next(clock))
    monkeypatch.setattr(console, "on_terminal", lambda: False)
    with console.described("tracing", interval=5.0) as shown:
        shown("8 trials, 45 unknowns, 2 cores: about 4 min", None)
        shown("every effect, iteration 1", 0.25)
        shown("every effect, iteration 2", 0.3)  # too soon
        shown("so far: no effect is needed; being confirmed", None)
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "8 trials, 45 unknowns, 2 cores: about 4 min",
        "every effect, iteration 1; about 30 s left",
        "so far: no effect is needed; being confirmed",
    ]


def test_an_estimate_by_trials_unknowns_and_cores(monkeypatch):
    monkeypatch.setattr(effort, "cores", lambda: 2)
    seconds = effort.fit_seconds(effort.TRACE, [3.0] * 8, 49, 21)
    assert 2 * seconds == pytest.approx(330, rel=0.2)  # CPU s of rig_e to rig_i: 310 to 380
    assert effort.fit_seconds(effort.TRACE, [3.0] * 16, 49, 21) == pytest.approx(2 * seconds)
    assert effort.fit_in_words(8, 49, seconds) == "8 trials, 49 unknowns, 2 cores: about 3 min"
    assert 2 * effort.trials_seconds(effort.EVALUATION, [1.0] * 5) == pytest.approx(
        10.1, rel=0.3
    )  # CPU s of practice_set,
    assert 2 * effort.trials_seconds(effort.EVALUATION, [3.0] * 10) == pytest.approx(23.1, rel=0.3)  # rig_d
    assert 2 * effort.trials_seconds(effort.TRAINING, [1.0] * 4) == pytest.approx(7.4, rel=0.3)
    assert 2 * effort.trials_seconds(effort.TRAINING, [3.0] * 8) == pytest.approx(20.2, rel=0.3)
    assert so_far(["filling_lag"]).startswith("so far: filling lag (pressure follows the set point")


def test_work_that_does_not_know_its_share_follows_the_clock_and_never_ends_early(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(effort.working_time, "seconds", lambda: now[0])
    pace, shares = effort.Pace(100.0), []
    for now[0] in (0.0, 50.0, 89.0, 91.0, 400.0):
        shares.append(pace.share())
    assert shares[:2] == [0.0, 0.5] and shares == sorted(shares) and shares[-1] < 1


def test_a_trace_of_a_bench_tells_its_share():
    shown = []
    examine(read_bench(ROOT / "examples/practice_bench/muscle"), 0.02, lambda line, share: shown.append((line, share)))
    shares = [share for _, share in shown]
    assert shares == sorted(shares) and shares[0] == 0 and 0.3 < shares[-1] < 1
    assert shown[-1][0] == "law and effects in turn"


def test_a_loop_says_what_it_takes_at_most(monkeypatch):
    monkeypatch.setattr("fabdesign.runtime.effort.cores", lambda: 2)
    estimate = loop_in_words(LoopStudy.read(ROOT / "examples/loop.toml"))
    assert estimate.startswith("at most 2 designs, 120 s of search and 5 trials for each, 2 cores: about ")
    assert int(estimate.split()[-2]) >= 4 and estimate.endswith("min")
