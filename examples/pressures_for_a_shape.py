"""Find the pressures of two muscles from the cloud of a shape that they made, and check that they are found."""

import numpy as np

from fabdesign.files.pressure_file import constant_program
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case, ForwardModel
from optimize.search.best import Stage
from optimize.search.design_space import DesignSpace
from optimize.search.evaluations import Evaluations
from optimize.search.history import History
from optimize.search.margins import Limits
from optimize.search.multistart import search
from optimize.search.objective import Objective, Target
from optimize.search.starts import pressure_starts


def main(forward: ForwardModel) -> np.ndarray:
    """(2,) Pa found for a cloud with 0.6 mm of noise."""
    design = build("cross")
    made_with = np.array([350e3, 150e3])  # Pa
    cloud = forward.equilibria([Case(design, constant_program(made_with))])[0]
    noisy = cloud + np.random.default_rng(1).normal(0.0, 0.6e-3, cloud.shape)

    space = DesignSpace(design, Limits(pressure=(0.0, 400e3)), np.full((1, 2), 200e3))
    stages = [Stage("pressures", forward, keep=2, rounds=10)]
    with History(":memory:", "example") as history:
        evaluations = Evaluations(
            Objective([Target(noisy)]), pressure_starts(space, 8, seed=1), stages, history, seconds=60, evaluations=500
        )
        reason = search(evaluations)
        space, x = evaluations.best_point()
    pressures = space.decode(x)[1][0]
    print(f"{reason}; found {pressures / 1e3} kPa, made with {made_with / 1e3} kPa")
    assert np.abs(pressures - made_with).max() < 15e3
    return pressures


if __name__ == "__main__":
    from sim import Simulator

    main(Simulator(points_per_side=21))
