"""The float64 reference with effects in it: what muscles, cloth, air and masses add.

Memory is what a step's evaluation leaves: each evaluation starts from the step before, so `tensions` is a function.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sp

from tests.sim.sim_reference import ReferenceSheet, Terms, unit


@dataclass
class Stress:
    """Elastic stresses of one sort: what they are conjugate to, their values times area, what stiffer places add."""

    terms: Terms
    value: np.ndarray
    more: np.ndarray
    stiffness: np.ndarray  # that the latter adds


class ReferenceWithEffects(ReferenceSheet):
    """creep: (share, time [s], share of it that the bench law has). hysteresis: (friction [N/Pa], friction at zero [N],
    slip). loss: share of the pressure at a muscle's far end. gains: by channel. drag [N s^2/m^4]. curl: across, down,
    twist [1/m]. threshold: (threshold, width) [Pa]. viscous: contracting, lengthening [N s]. patch: (u, v, radius [m],
    factor). relaxation: (share, time [s]). added: (u, v [m], kg). learned: tension by contraction at 200 kPa, at any
    pressure [N]."""

    def __init__(
        self, design, n, *, creep=(0.0, 1.0, 0.0), hysteresis=(0.0, 0.0, 1.0), loss=0.0, gains=None, drag=0.0,
        curl=(0.0, 0.0, 0.0), threshold=(0.0, 1.0), viscous=(0.0, 0.0), patch=(0.0, 0.0, 1.0, 1.0),
        relaxation=(0.0, 1.0), added=(0.0, 0.0, 0.0), learned=(0.0, 0.0), factors=None,
    ):  # fmt: skip
        super().__init__(design, n, factors)
        self.curl, self.threshold, self.viscous, self.relaxation = curl, threshold, viscous, relaxation
        self.creep, self.hysteresis, self.drag, self.learned = creep, hysteresis, drag, learned
        counts = [len(muscle.fixed_points()) - 1 for muscle in design.muscles]
        along = np.concatenate([(np.arange(c) + 0.5) / c for c in counts])  # even intervals
        self.share = (1 - loss * along) * 1.0
        self.gain = np.array([(gains or {}).get(int(c), 1.0) for c in self.channel])
        self.ages = 0.0  # s, in a step; none at rest
        self.lent = self.friction = self.before = np.zeros(len(along))
        self.relaxed = None
        self.stiffer = self._stiffer(*patch)
        u, v, mass = added
        hats = (np.maximum(1 - np.abs(np.arange(n) - at / h), 0) for at, h in zip((v, u), self.h[::-1], strict=True))
        self.mass = self.mass + mass * np.outer(*hats).ravel()

    def _stiffer(self, u, v, radius, factor):
        """(n n,) means over the nodes' areas."""
        n, fine = self.n, 20
        ends = [np.clip((np.arange(n + 1) - 0.5) * h, 0, (n - 1) * h) for h in self.h]
        at = [(e[:-1, None] + np.diff(e)[:, None] * (np.arange(fine) + 0.5) / fine).ravel() for e in ends]
        uu, vv = np.meshgrid(*at)
        inside = 1 / (1 + np.exp((np.hypot(uu - u, vv - v) - radius) / 0.001))
        return (factor - 1) * inside.reshape(n, fine, n, fine).mean(axis=(1, 3)).ravel()

    def curvatures(self, x, direction):
        terms = super().curvatures(x, direction)
        return replace(terms, value=terms.value - self.curl[direction])

    def twists(self, x):
        terms = super().twists(x)
        return replace(terms, value=terms.value - self.curl[2])

    # --- muscles

    def acting(self, pressure):
        acting = pressure[self.channel] * self.share
        threshold, width = self.threshold
        return width * np.logaddexp(0, (acting - threshold) / width) if threshold else acting

    def viscosities(self, rate):
        return super().viscosities(rate) + np.where(rate > 0, *self.viscous)

    def tensions(self, contraction, pressure):
        share, _, on_bench = self.creep
        seen = contraction - self._lent(contraction) + on_bench * share * np.maximum(contraction, 0)
        idle = super().tensions(seen, np.zeros(len(pressure)))
        force = idle + self.gain * (super().tensions(seen, pressure) - idle)
        stroke, spring = self.learned
        more = (stroke * self.acting(np.asarray(pressure, float)) / 200e3 + spring) * contraction
        return force + more - self._friction(contraction, pressure)

    def _lent(self, contraction):
        share, time, _ = self.creep
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
        self.relaxed = self.relaxed_next

    # --- cloth

    def _stresses(self, x):
        strains = [self.edge_strains(x, d)[0] for d in (0, 1)]
        mean = [strains[d].value[self.cell_edges[d]].mean(1) for d in (0, 1)]
        on_cells = self.stiffer[self.corners].mean(1)
        for d, terms in enumerate(strains):
            area, on_edges = self.edges[d][2], self.stiffer[terms.nodes].mean(1)
            value, more = area * self.k[d] * terms.value, on_edges * area * self.k[d] * terms.value
            of_cells = self.k[2] * mean[1 - d] * self.cell / 2
            np.add.at(value, self.cell_edges[d].ravel(), np.repeat(of_cells, 2))
            np.add.at(more, self.cell_edges[d].ravel(), np.repeat(on_cells * of_cells, 2))
            yield Stress(terms, value, more, on_edges * area * self.k[d])
        for terms, modulus in ((self.shear_angles(x), self.shear), (self.twists(x), 2 * self.twist)):
            value = self.cell * modulus * terms.value
            yield Stress(terms, value, on_cells * value, on_cells * self.cell * modulus)
        first, second, (d1, d2, d12) = self.curvatures(x, 0), self.curvatures(x, 1), self._plate()
        for terms, bending, other in ((first, d1, second), (second, d2, first)):
            value = self.area * (bending * terms.value + d12 * other.value)
            yield Stress(terms, value, self.stiffer * value, self.stiffer * self.area * bending)
        if self.design.fabric.support == "clamped":
            terms, weight = self.held_normal(x), self._held_weight()
            there = self.stiffer[self.nodes[0]]
            yield Stress(terms, weight * terms.value, there * weight * terms.value, there * weight)

    def evaluate(self, x, velocity, pressure, cv=0.0):
        force, stiffness = super().evaluate(x, velocity, pressure, cv)
        (west, east), (north, south) = self.neighbours
        normal, _ = unit(np.cross(x[south] - x[north], x[east] - x[west]))
        speed = np.sum(velocity * normal, axis=1)
        force = force - (self.drag * self.area * np.abs(speed) * speed)[:, None] * normal
        share, time = self.relaxation
        aged = -np.expm1(-self.ages / time) if self.ages else 1.0
        self.relaxed_next = []
        for k, stress in enumerate(self._stresses(x)):
            total, before = stress.value + stress.more, 0.0 if self.relaxed is None else self.relaxed[k]
            self.relaxed_next.append(before + aged * (total - before))
            pull = stress.more - share * self.relaxed_next[-1]
            np.add.at(force, stress.terms.nodes, -pull[:, None, None] * stress.terms.gradient)
            jacobian = stress.terms.jacobian(x.size)
            stiffness = stiffness + jacobian.T @ sp.diags(stress.stiffness) @ jacobian
        return force, stiffness

    def motion(self, pressure, h, steps, *, rho, start, jumps=()):
        idle = np.zeros(self.design.channels)
        self.ages = 0.0
        self.evaluate(start, 0 * start, idle)
        self.remember(idle)
        self.ages = h
        return super().motion(pressure, h, steps, rho=rho, start=start, jumps=jumps)
