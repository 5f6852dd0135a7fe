"""A search for an array of points: pressures are found again from 421 points of the shape that they make."""

import numpy as np

import fabdesign


def main(evaluations: int = 2000, grid: int = 41) -> None:
    cloth, model = fabdesign.build("vertical", muscles=2), fabdesign.Model(points_per_side=grid)
    pressures = [220, 140]  # kPa
    points = fabdesign.equilibrium(cloth, pressures, model=model).points[0, ::8]  # (n, 3) m
    result = fabdesign.optimize(cloth, points, model=model, evaluations=evaluations)
    print(f"{result.pressures[0].round()} kPa: {1e3 * result.objective:.2f} mm from the {len(points)} points")
    assert np.abs(result.pressures[0] - pressures).max() < 15


if __name__ == "__main__":
    main()
