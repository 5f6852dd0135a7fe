"""Widths of prediction intervals are judged right: the score, the regions, and trials left out."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from benchmarks.spread import widths
from benchmarks.spread_layouts import LAYOUTS, layout, programs, table
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.model_file import read_model, write_model
from fabdesign.nouns.model import NORMAL90, Model
from fabdesign.nouns.model_sampling import half_widths
from studies.intervals.calibrate import crps, spread_from
from studies.intervals.draws import RegionResiduals, by_region


def test_a_design_with_enough_trials_has_a_width_of_its_own(tmp_path: Path) -> None:
    """One that is predicted three times worse, and one of too few trials to say."""
    rng = np.random.default_rng(1)
    size = {"well": 1e-3, "badly": 3e-3, "seldom": 3e-3}

    def trials(name: str, count: int) -> list[RegionResiduals]:
        rest = np.full(400, 0.01)
        return [RegionResiduals(name, rng.normal(0, size[name], 400), rest, rest) for _ in range(count)]

    every = [one for name, count in (("well", 6), ("badly", 6), ("seldom", 2)) for one in trials(name, count)]
    spread, _ = spread_from(every, [*range(len(every))], Model())
    write_model(Model(spread=spread), tmp_path / "m.toml")
    read = read_model(tmp_path / "m.toml").spread
    assert read == spread and set(spread.designs) == {"well", "badly"}
    for name in ("well", "badly"):
        [fresh] = trials(name, 1)
        half = half_widths(spread, fresh.deviation, fresh.moved, name)
        assert float((np.abs(fresh.residual) <= half).mean()) == pytest.approx(0.9, abs=0.04)
    assert half_widths(spread, fresh.deviation, fresh.moved, "seldom") == pytest.approx(
        half_widths(spread, fresh.deviation, fresh.moved)
    )


@pytest.mark.parametrize(("residual", "sigma"), [(0.0, 1.0), (2.5, 0.7), (-0.3, 2.0)])
def test_score_is_its_integral(residual: float, sigma: float) -> None:
    # CRPS = integral of (F(x) - [x >= residual])^2
    low = quad(lambda x: norm.cdf(x / sigma) ** 2, -30, residual)[0]
    high = quad(lambda x: norm.sf(x / sigma) ** 2, residual, 30)[0]
    assert crps(np.array([residual]), np.array([sigma]))[0] == pytest.approx(low + high, rel=1e-6)


def test_regions_share_the_nodes() -> None:
    sums = by_region(np.ones((2, 11, 11)))
    assert sums.shape == (2, 3, 3) and (sums.sum(axis=(1, 2)) == 121).all()


def test_intervals_that_follow_the_motion_are_narrower_where_it_is_small() -> None:
    """RegionResiduals in proportion to the motion: both ways are right nine times in ten, one of them says where."""
    rng = np.random.default_rng(0)
    every = []
    for k in range(6):
        moved = rng.uniform(0.0, 0.1, 300)
        residual = 0.05 * moved * rng.standard_normal(300)
        every.append(RegionResiduals("one" if k % 2 else "two", residual, np.full(300, 1e-5), moved))
    sigmas = widths(every)

    def inside(name: str) -> float:
        off = [np.abs(one.residual) <= NORMAL90 * sigma for one, sigma in zip(every, sigmas[name], strict=True)]
        return float(np.concatenate(off).mean())

    def score(name: str) -> float:
        return float(
            np.mean([crps(one.residual, sigma).mean() for one, sigma in zip(every, sigmas[name], strict=True)])
        )

    assert inside("joint covariance alone") < 0.1
    assert inside("constant") == pytest.approx(0.9, abs=0.04) and inside("all") == pytest.approx(0.9, abs=0.04)
    assert score("all") < 0.95 * score("constant")


def test_ten_layouts_differ_and_can_be_made(tmp_path: Path) -> None:
    designs = [layout(number) for number in range(LAYOUTS)]
    for number, design in enumerate(designs):
        write_design(design, tmp_path / "design.toml")
        assert read_design(tmp_path / "design.toml") == design  # its paths lie on the cloth
        assert 2 <= len(design.muscles) <= 6 and design.fabric == designs[0].fabric
        for program in programs(number, design.channels):
            assert program.pressure.shape == (2, design.channels) and program.pressure.max() <= 300e3
    assert len({tuple(muscle.path for muscle in design.muscles) for design in designs}) == LAYOUTS


def test_a_width_that_follows_the_motion_is_narrower_than_the_constant_that_holds_as_many() -> None:
    rng = np.random.default_rng(2)

    def trials(names: list[str]) -> list[RegionResiduals]:
        moved = [rng.uniform(0.0, 0.1, 400) ** 2 for _ in names]
        pairs = zip(names, moved, strict=True)
        return [RegionResiduals(name, 0.1 * m * rng.standard_normal(400), np.full(400, 1e-6), m) for name, m in pairs]

    calibration_trials, others = trials(["layout_0"] * 6), trials(["layout_1"] * 3)
    spread, _ = spread_from(calibration_trials, [*range(6)], Model())
    lines = [line.split(" | ") for line in table(Model(spread=spread), calibration_trials, others).splitlines()[2:6]]
    rows = {cells[2]: (float(cells[3].rstrip("%")), float(cells[4])) for cells in lines}
    assert rows["the model"][0] == pytest.approx(90, abs=4) and rows["the joint covariance alone"][0] < 10
    assert rows["a constant that holds as many"][0] == pytest.approx(rows["the model"][0], abs=1)
    assert rows["the model"][1] < rows["a constant that holds as many"][1]
