"""The speed benchmark: its loops in C compute what Taichi's do, and it writes its part of the page alone."""

import pytest

from benchmarks.machine import ROOT, with_part
from benchmarks.sim import kernel
from benchmarks.sim.measure import Figure


def test_loops_in_c_agree_with_taichi():
    why = kernel.missing()
    if why:
        pytest.skip(why)
    assert max(kernel.disagreement(21)) < 1e-4


PARTS = (
    ("benches", "benches"), ("benches", "made benches"), ("compiler", "devices"), ("derivatives", "derivatives"),
    ("follow", "table"), ("fuse", "recordings"), ("loop", "loop"), ("machines", "cluster"), ("search", "search"),
    ("simulator", "bench-sim"), ("studio", "studio"), ("trace", "table"),
)  # fmt: skip


def test_page_keeps_what_is_not_the_benchmarks():
    text = "a\n<!-- one -->\nold\n<!-- end of one -->\nb\n"
    assert with_part(text, "one", "new\n") == text.replace("old", "new")
    assert with_part(with_part(text, "one", "new"), "one", "old") == text
    with pytest.raises(SystemExit, match="no <!-- one -->"):
        with_part("a\n", "one", "new")


def test_each_benchmark_has_its_part_of_a_page_and_leaves_what_people_wrote():
    pages = {page: (ROOT / "docs" / "lab" / f"{page}.md").read_text(encoding="utf-8") for page, _ in PARTS}
    for page, name in PARTS:
        pages[page] = with_part(pages[page], name, "")
    assert "Where each pose needs its own muscles" in pages["search"] and "## Other searches" not in pages["search"]
    assert "## A loop that trains" in pages["loop"] and "## Motions: what was tried" in pages["derivatives"]


def test_row_that_misses_its_bound_is_bold():
    assert Figure("wall", [4.0, 2.0, 3.0], " s", 3.0).row() == "| wall | at most 3 s | 3 s (2..4) |"
    assert Figure("wall", [3.5], " s", 3.0).row() == "| **wall** | **at most 3 s** | **3.5 s** |"
    assert Figure("ratio", [19.0], "", 20.0, at_least=True).missed
    assert Figure("wall", [3.5], " s").row() == "| wall |  | 3.5 s |"
