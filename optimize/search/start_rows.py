"""Layouts and their pressures as rows that JSON holds exactly."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any, TypedDict

import numpy as np

from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from optimize.search.design_space import DesignSpace
from optimize.search.margins import Limits
from optimize.search.starts import Start


class StartRow(TypedDict):
    """A layout and its pressures."""

    muscles: list[dict[str, Any]]  # what a Muscle is made of
    pressures: list[list[float]]  # Pa, of each pose


def as_rows(starts: Sequence[Start]) -> list[StartRow]:
    """Return muscles, and (poses, channels) pressures in Pa."""
    rows: list[StartRow] = []
    for space, x in starts:
        design, pressures = space.decode(x)
        rows.append({"muscles": [asdict(muscle) for muscle in design.muscles], "pressures": pressures.tolist()})
    return rows


def of_rows(rows: Sequence[StartRow], cloth: Design, limits: Limits) -> list[Start]:
    """Return what `as_rows` gave, on the cloth and with the muscle types of a design."""
    starts = []
    for row in rows:
        paths = [tuple((float(u), float(v)) for u, v in muscle["path"]) for muscle in row["muscles"]]
        muscles = [Muscle(**{**keys, "path": path}) for keys, path in zip(row["muscles"], paths, strict=True)]
        design, pressures = replace(cloth, muscles=tuple(muscles)), np.array(row["pressures"], dtype=float)
        space = DesignSpace(design, limits, pressures, vary_positions=True)
        starts.append((space, space.encode(design, pressures)))
    return starts
