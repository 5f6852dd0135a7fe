"""The motion that all rows are about: *basic* with 4 muscles, 90 frames at 60 Hz, random steps of pressure."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.pressure import PressureProgram

FRAMES = 90
FRAME = 1 / 60  # s
TIMES: NDArray[np.float64] = FRAME * np.arange(1.0, FRAMES + 1)  # s
STEPS = (0.0, 0.25, 0.75)  # s
MOST = 400e3  # Pa
SEED = 41


def reference(count: int) -> list[Case]:
    """`count` cases of one design, each with its own pressures of 0 to MOST; the first do not depend on `count`."""
    design = build("basic", muscles=4)
    rng = np.random.default_rng(SEED)
    return [
        Case(design, PressureProgram(np.array(STEPS), rng.uniform(0.0, MOST, (len(STEPS), 4)), FRAMES * FRAME))
        for _ in range(count)
    ]
