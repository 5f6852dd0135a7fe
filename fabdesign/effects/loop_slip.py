"""Loop slip: a muscle slides through its fixed points, where tensions on both sides differ by more than friction."""

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, Values
from fabdesign.effects.specimen import Specimen


def _specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(
        muscles, slip_friction=values["friction"], slip_grip=values["grip"], slip_mobility=values["mobility"]
    )


LOOP_SLIP = Effect(
    "loop_slip",
    site="interface",
    scope="fabric",
    what="a muscle slides through a fixed point towards the higher tension where tensions differ by more than friction "
    "times their mean and grip, at `mobility` times excess L / (6 c) m/s; L its interval's length, c its viscosity",
    signature="a gradient of contraction along the path, the other way round deflating; stays at hold; one muscle by "
    "itself shows it",
    looks_like="a lacing that is looser at one end, or a muscle that is not even along its length; mark the muscle at "
    "its fixed points and film the marks",
    source="capstan friction at a point with viscous sliding beyond it; docs/effects.md",
    parameters={
        "mobility": EffectParameter("1", "of the sliding", 1.0, (0.0, 100.0), 0.5, off=0.0),
        "friction": EffectParameter("1", "share of the mean tension", 0.02, (0.001, 2.0), 1.0, transform="log"),
        "grip": EffectParameter("N", "without tension", 0.02, (0.0, 10.0), 0.05),
    },
    specimen=_specimen,
    force="sim.effects.loop_slip:LOOP_SLIP",
    remembers=True,
)
