"""The examples: each asserts a physical outcome itself."""

import runpy
from collections.abc import Callable

import pytest

from tests.conftest import ROOT


def example(name: str) -> Callable[..., object]:
    main: Callable[..., object] = runpy.run_path(str(ROOT / "examples" / f"{name}.py"))["main"]
    return main


@pytest.mark.parametrize("name", ["pressures_for_a_shape", "front_muscles_curl"])
def test_example_on_the_simulator(name: str) -> None:
    from sim import Simulator

    example(name)(Simulator(points_per_side=21))


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("sweep_of_200_designs", {"grid": 11}),
        ("sobol_of_a_corner", {"grid": 11, "samples": 8}),
        ("search_for_points", {"grid": 21, "evaluations": 40}),
    ],
)
def test_script(name: str, options: dict[str, int]) -> None:
    pytest.importorskip("pandas", reason="the extra tables is not installed")
    example(name)(**options)
    assert len((ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8").splitlines()) <= 20
