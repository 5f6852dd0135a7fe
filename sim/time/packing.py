"""Which case rides in which lane."""

import os
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from sim.kernels.fields import LANES

BLOCKS = 8  # of LANES designs in the fields at once


def pack(patterns: Sequence[tuple]) -> list[list[int]]:
    """Return blocks of LANES indices each, of cases whose steps are of the `patterns` (sortable): those alike together,
    for a block takes as many steps as the lane with the most, and factors whenever one of them changes; spare lanes
    repeat the last case. Unlike cases ride beside their neighbours in order, in so many blocks that all threads have
    work."""
    order = sorted(range(len(patterns)), key=lambda i: (patterns[i], i))
    groups = [list(group) for _, group in groupby(order, key=lambda i: patterns[i])]
    blocks = [group[k : k + LANES] for group in groups for k in range(0, len(group) - LANES + 1, LANES)]
    remainders = [group[len(group) // LANES * LANES :] for group in groups]
    rest = [i for group in remainders for i in group]
    if rest:
        count = -(-len(rest) // LANES)
        if sum(map(bool, remainders)) > 1:
            threads = os.cpu_count() or 1
            count = min(count + -(len(blocks) + count) % threads, len(rest))
        blocks += [part.tolist() for part in np.array_split(rest, count)]
    return [block + block[-1:] * (LANES - len(block)) for block in blocks]
