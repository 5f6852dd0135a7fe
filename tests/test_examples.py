"""The examples: each asserts a physical outcome itself."""

import runpy
from collections.abc import Callable

import pytest

from fabdesign.forward import ForwardModel
from tests.conftest import ROOT


def example(name: str) -> Callable[[ForwardModel], object]:
    main: Callable[[ForwardModel], object] = runpy.run_path(str(ROOT / "examples" / f"{name}.py"))["main"]
    return main


@pytest.mark.parametrize("name", ["pressures_for_a_shape", "front_muscles_curl"])
def test_example_on_the_simulator(name: str) -> None:
    from sim import Simulator

    example(name)(Simulator(points_per_side=21))
