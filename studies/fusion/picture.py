"""The picture of a fusion: one frame before and after, from the front and in a slice."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fabdesign.units import in_mm

Array = NDArray[np.float64]
SLICE = 0.008  # m, half the slice's width


def draw(before: Mapping[str, Array], after: Mapping[str, Array], path: Path, *, title: str) -> None:
    """Clouds (n, 3) m by sensor name, placed by the nominal and by the registered poses, as a PNG."""
    figure = Figure(figsize=(12, 9), layout="constrained")
    axes = figure.subplots(2, 2)
    middle = in_mm(float(np.median(np.concatenate(list(after.values()))[:, 1])))
    for column, (name, clouds) in enumerate((("before: nominal poses", before), ("after: registered, cleaned", after))):
        _scatter(axes[0, column], clouds, (0, 1), title=f"{name}, from the front")
        slices = {k: c[np.abs(in_mm(c[:, 1]) - middle) < in_mm(SLICE)] for k, c in clouds.items()}
        _scatter(axes[1, column], slices, (0, 2), title=f"{name}, slice at y = {middle:.0f} mm")
    limits = [in_mm(np.concatenate(list(before.values()))[:, k]) for k in range(3)]
    for column in range(2):
        for row, k in ((0, 1), (1, 2)):
            axes[row, column].set_xlim(*np.percentile(limits[0], [0.1, 99.9]) + [-10, 10])
            axes[row, column].set_ylim(*np.percentile(limits[k], [0.5, 99.5]) + [-10, 10])
    axes[0, 0].legend(markerscale=5, fontsize="small")
    figure.suptitle(title)
    figure.savefig(path, dpi=110, format="png")


def _scatter(axes: Axes, clouds: Mapping[str, Array], axis: tuple[int, int], *, title: str) -> None:
    for name, cloud in clouds.items():
        axes.plot(in_mm(cloud[:, axis[0]]), in_mm(cloud[:, axis[1]]), ".", markersize=2, label=name)
    axes.set_title(title)
    axes.set_xlabel(f"{'xyz'[axis[0]]} [mm]")
    axes.set_ylabel(f"{'xyz'[axis[1]]} [mm]")
