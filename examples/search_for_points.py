"""A search for an array of points: an arc of 0.12 m radius, which two muscles on the front come close to."""

import numpy as np

import fabdesign


def main(evaluations: int = 2000, grid: int = 41) -> None:
    x, s = np.meshgrid(np.linspace(-0.1, 0.1, 15), np.linspace(0, 0.2, 15))  # m: across, and down along the cloth
    arc = np.stack([x, -0.12 * np.sin(s / 0.12), 0.12 * (1 - np.cos(s / 0.12))], axis=-1).reshape(-1, 3)
    cloth, model = fabdesign.build("vertical", muscles=2), fabdesign.Model(points_per_side=grid)
    found = fabdesign.optimize(cloth, arc, model=model, evaluations=evaluations)
    print(f"{found.pressures[0].round()} kPa: {1e3 * found.objective:.1f} mm from the points")
    assert found.objective < 0.7 * found.found.rest_errors.chamfer and found.pressures.min() > 20


if __name__ == "__main__":
    main()
