"""Which muscle of *cross* moves the lower right corner: the one that ends there, far more than the cloth's mass."""

import fabdesign


def main(grid: int = 21, samples: int = 64) -> None:
    result = fabdesign.sensitivity(
        fabdesign.build("cross", muscles=2),
        {"pressure.0": (50, 150), "pressure.1": (50, 150), "areal_density": (0.9, 1.1)},  # kPa, kPa, factor
        outputs={"corner": lambda motion: 1e3 * motion.faces[0, 0, -1, -1, 2]},  # mm towards the viewer
        method="sobol", samples=samples, grid=grid,
    )  # fmt: skip
    total = {name: index["total"] for name, index in result.indices("corner").items()}
    print({name: round(share, 2) for name, share in total.items()})
    assert max(total["pressure.0"], total["pressure.1"]) > 5 * total["areal_density"]


if __name__ == "__main__":
    main()
