"""The speed benchmark: its loops in C compute what Taichi's do, and it writes its part of the page alone."""

import pytest

from benchmarks.sim import kernel
from benchmarks.sim.measure import Figure
from benchmarks.sim.page import PAGE, replaced


def test_loops_in_c_agree_with_taichi():
    why = kernel.missing()
    if why:
        pytest.skip(why)
    assert max(kernel.disagreement(21)) < 1e-4


def test_page_keeps_what_is_not_the_benchmarks():
    text = "a\n<!-- bench-sim -->\nold\n<!-- /bench-sim -->\nb\n"
    assert replaced(text, "new\n") == "a\n<!-- bench-sim -->\nnew\n<!-- /bench-sim -->\nb\n"
    assert replaced(replaced(text, "new"), "old") == text
    with pytest.raises(SystemExit, match="no <!-- bench-sim -->"):
        replaced("a\n", "new")
    replaced(PAGE.read_text(encoding="utf-8"), "new")


def test_row_that_misses_its_bound_is_bold():
    assert Figure("wall", [4.0, 2.0, 3.0], " s", 3.0).row() == "| wall | at most 3 s | 3 s (2..4) |"
    assert Figure("wall", [3.5], " s", 3.0).row() == "| **wall** | **at most 3 s** | **3.5 s** |"
    assert Figure("ratio", [19.0], "", 20.0, at_least=True).missed
    assert Figure("wall", [3.5], " s").row() == "| wall |  | 3.5 s |"
