"""Muscles on pressure channels: one each, or shared ones where there are fewer channels or pressures agree."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.muscle import Muscle
from optimize.search.design_space import DesignSpace, Vector

Pressures = NDArray[np.float64]
Layout = tuple[Sequence[Muscle], Pressures]  # and (poses, muscles) Pa
Groups = list[list[int]]  # muscles, from 0, that share a channel

SHARED = 0.05  # of the pressure range, within which two muscles may share a channel in every pose


def start_of(layout: Layout, space: DesignSpace) -> tuple[DesignSpace, Vector] | None:
    """Return the layout on the cloth of `space`, with a channel for each muscle or, where its limits have fewer, with
    those on one channel whose pressures are nearest; None where a limit is broken."""
    grouped = _on_channels(layout, space, _nearest_groups(layout[1], space.limits.channels))
    return grouped if grouped[0].feasible(grouped[1]) else None


def by_muscle(start: tuple[DesignSpace, Vector]) -> Layout:
    """Return the muscles of a start, and what acts in each."""
    design, pressures = start[0].decode(start[1])
    return design.muscles, pressures[:, [muscle.channel for muscle in design.muscles]]


def with_shared_channels(start: tuple[DesignSpace, Vector]) -> tuple[DesignSpace, Vector] | None:
    """Return the same layout with muscles on one channel whose pressures agree in every pose, at their mean; None where
    that saves no channel."""
    space = start[0]
    muscles, levels = by_muscle(start)
    low, high = space.limits.pressure
    groups: Groups = []
    for k in range(len(muscles)):
        alike = (g for g in groups if np.all(np.abs(levels[:, k] - levels[:, g[0]]) <= SHARED * (high - low)))
        group = next(alike, None)
        if group is None:
            groups.append([k])
        else:
            group.append(k)
    return _on_channels((muscles, levels), space, groups) if len(groups) < space.channels else None


def _nearest_groups(pressures: Pressures, most: int | None) -> Groups:
    """Return at most so many groups: the two whose mean pressures are nearest become one until they are that few."""
    groups: Groups = [[k] for k in range(pressures.shape[1])]
    while most is not None and len(groups) > most:
        means = [pressures[:, group].mean(axis=1) for group in groups]
        pairs = combinations(range(len(groups)), 2)
        i, j = min(pairs, key=lambda pair: float(np.linalg.norm(means[pair[0]] - means[pair[1]])))
        groups[i] += groups.pop(j)
    return groups


def _on_channels(layout: Layout, space: DesignSpace, groups: Groups) -> tuple[DesignSpace, Vector]:
    """Return groups that share a channel have their mean pressure."""
    muscles, pressures = layout
    channel_of = {k: channel for channel, group in enumerate(groups) for k in group}
    placed = tuple(replace(muscle, channel=channel_of[k]) for k, muscle in enumerate(muscles))
    shared = np.stack([pressures[:, group].mean(axis=1) for group in groups], axis=1)
    reduced = replace(space, design=replace(space.design, muscles=placed), start_pressures=shared, vary_positions=True)
    return reduced, reduced.encode(reduced.design, shared)
