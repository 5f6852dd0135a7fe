"""The float64 reference with effects in it: creep, braid hysteresis, line loss, gains of channels, quadratic drag, rest
curvature.

Memory is what a step's evaluation leaves: each evaluation starts from the step before, so `tensions` is a function.
"""

from dataclasses import replace

import numpy as np

from tests.sim_reference import ReferenceSheet, unit


class ReferenceWithEffects(ReferenceSheet):
    """creep: (share, time [s]). hysteresis: (friction [N/Pa], friction at zero [N], slip). loss: share of the pressure
    at a muscle's far end. gains: by channel. drag [N s^2/m^4]. curl: across, down, twist [1/m]."""

    def __init__(
        self, design, n, *, creep=(0.0, 1.0), hysteresis=(0.0, 0.0, 1.0), loss=0.0, gains=None, drag=0.0,
        curl=(0.0, 0.0, 0.0),
    ):  # fmt: skip
        super().__init__(design, n)
        self.curl = curl
        self.creep, self.hysteresis, self.drag = creep, hysteresis, drag
        counts = [len(muscle.fixed_points()) - 1 for muscle in design.muscles]
        along = np.concatenate([(np.arange(c) + 0.5) / c for c in counts])  # even intervals
        self.share = (1 - loss * along) * 1.0
        self.gain = np.array([(gains or {}).get(int(c), 1.0) for c in self.channel])
        self.ages = 0.0  # s, in a step; none at rest
        self.lent = self.friction = self.before = np.zeros(len(along))

    def curvatures(self, x, direction):
        terms = super().curvatures(x, direction)
        return replace(terms, value=terms.value - self.curl[direction])

    def twists(self, x):
        terms = super().twists(x)
        return replace(terms, value=terms.value - self.curl[2])

    def acting(self, pressure):
        return pressure[self.channel] * self.share

    def tensions(self, contraction, pressure):
        self.now = self._lent(contraction), self._friction(contraction, pressure)
        seen = contraction - self.now[0]
        idle = super().tensions(seen, np.zeros(len(pressure)))
        return idle + self.gain * (super().tensions(seen, pressure) - idle) - self.now[1]

    def _lent(self, contraction):
        share, time = self.creep
        return self.lent - np.expm1(-self.ages / time) * (share * np.maximum(contraction, 0) - self.lent)

    def _friction(self, contraction, pressure):
        per_pressure, at_zero, slip = self.hysteresis
        limit = at_zero + per_pressure * self.acting(np.asarray(pressure, float))
        if not self.ages:
            return 0 * limit
        return np.clip(self.friction + limit / slip * (contraction - self.before), -limit, limit)

    def remember(self, pressure):
        lent, friction = self._lent(self.contraction), self._friction(self.contraction, pressure)
        self.lent, self.friction, self.before = lent, friction, self.contraction.copy()

    def evaluate(self, x, velocity, pressure, cv=0.0):
        force, stiffness = super().evaluate(x, velocity, pressure, cv)
        (west, east), (north, south) = self.neighbours
        normal, _ = unit(np.cross(x[south] - x[north], x[east] - x[west]))
        speed = np.sum(velocity * normal, axis=1)
        return force - (self.drag * self.area * np.abs(speed) * speed)[:, None] * normal, stiffness

    def motion(self, pressure, h, steps, *, rho, start, jumps=()):
        idle = np.zeros(self.design.channels)
        self.ages = 0.0
        self.evaluate(start, 0 * start, idle)
        self.remember(idle)
        self.ages = h
        return super().motion(pressure, h, steps, rho=rho, start=start, jumps=jumps)
