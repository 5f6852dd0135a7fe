"""A slow, obvious float64 reference of the discrete model of docs/model.md: what the kernels of `sim` must reproduce.

Every elastic term is a list of constraints: the nodes it touches, its value and its gradient. Newton's method with a
sparse direct solver finds equilibria and the steps of generalised-alpha.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import PARAMETERS
from fabdesign.nouns.muscle_law import MuscleLaw


@dataclass
class Terms:
    """m constraints on k nodes each: nodes (m, k), value (m,), gradient (m, k, 3) 1/m."""

    nodes: np.ndarray
    value: np.ndarray
    gradient: np.ndarray

    def rate(self, velocity):
        return np.einsum("mkc,mkc->m", self.gradient, velocity[self.nodes])

    def jacobian(self, size):
        m, k = self.nodes.shape
        rows = np.repeat(np.arange(m), 3 * k)
        columns = (3 * self.nodes[..., None] + np.arange(3)).ravel()
        return sp.csr_matrix((self.gradient.ravel(), (rows, columns)), shape=(m, size))


def unit(a):
    length = np.linalg.norm(a, axis=-1)
    return a / length[..., None], length


def across(a, n):
    """The part of `a` normal to the unit vectors `n`."""
    return a - n * np.sum(n * a, axis=-1, keepdims=True)


LOOP = 0.005  # m
WIDENED = 1 / 8  # of the square of the spacing, added to that of LOOP


def bspline(x):
    """Cubic B-spline with knots at whole numbers."""
    r = np.abs(x)
    return np.where(r < 1, 2 / 3 - r**2 + r**3 / 2, np.where(r < 2, (2 - r) ** 3 / 6, 0.0))


def bspline_slope(x):
    """d/dt of bspline(x) for x = node - t."""
    r = np.abs(x)
    return -np.sign(x) * np.where(r < 1, -2 * r + 1.5 * r**2, np.where(r < 2, -((2 - r) ** 2) / 2, 0.0))


def catmull_rom(x):
    r = np.abs(x)
    return np.where(r < 1, 1 - 2.5 * r**2 + 1.5 * r**3, np.where(r < 2, 2 - 4 * r + 2.5 * r**2 - r**3 / 2, 0.0))


def catmull_rom_slope(x):
    r = np.abs(x)
    return -np.sign(x) * np.where(r < 1, -5 * r + 4.5 * r**2, np.where(r < 2, -4 + 5 * r - 1.5 * r**2, 0.0))


class ReferenceSheet:
    """One design on an n x n grid. Node (row j, column i) has index j n + i; positions are (n n, 3) m."""

    def __init__(self, design: Design, n: int, factors: Mapping[str, float] | None = None):
        fabric, factor = design.fabric, dict.fromkeys(PARAMETERS, 1.0) | dict(factors or {})
        self.design, self.n, self.factor = design, n, factor
        self.h = np.array([fabric.width, fabric.height]) / (n - 1)
        nodes = np.arange(n * n).reshape(n, n)
        self.nodes = nodes
        width = np.ones(n)
        width[[0, -1]] = 0.5
        self.cell = self.h[0] * self.h[1]
        self.area = self.cell * np.outer(width, width).ravel()
        u, v = np.meshgrid(np.linspace(0, fabric.width, n), np.linspace(0, fabric.height, n))
        self.rest = np.stack([u - fabric.width / 2, -v, 0 * u], axis=-1).reshape(-1, 3)
        self.mass = factor["areal_density"] * fabric.areal_density * self.area
        self.free = np.ones((n, n), bool)
        held = {"top": (0,), "bottom": (-1,), "left": (slice(None), 0), "right": (slice(None), -1)}
        if fabric.hung != "none":
            self.free[held[fabric.hung]] = False
        self.free = self.free.ravel()
        # edges along u and v: start, end, and the area each stands for
        self.edges = [
            (nodes[:, :-1].ravel(), nodes[:, 1:].ravel(), self.cell * np.repeat(width, n - 1)),
            (nodes[:-1].ravel(), nodes[1:].ravel(), self.cell * np.tile(width, n - 1)),
        ]
        self.corners = np.stack([nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, :-1], nodes[1:, 1:]], axis=-1).reshape(
            -1, 4
        )
        along_u, along_v = np.arange(n * (n - 1)).reshape(n, n - 1), np.arange(n * (n - 1)).reshape(n - 1, n)
        self.cell_edges = [
            np.stack([along_u[:-1], along_u[1:]], axis=-1).reshape(-1, 2),
            np.stack([along_v[:, :-1], along_v[:, 1:]], axis=-1).reshape(-1, 2),
        ]
        row, column = (a.ravel() for a in np.mgrid[:n, :n])
        before, after = (lambda a: np.maximum(a - 1, 0)), (lambda a: np.minimum(a + 1, n - 1))
        self.neighbours = [
            (nodes[row, before(column)], nodes[row, after(column)]),
            (nodes[before(row), column], nodes[after(row), column]),
        ]
        self.inner = [(column > 0) & (column < n - 1), (row > 0) & (row < n - 1)]
        self._materials()
        self._lace()

    def _materials(self):
        fabric, factor = self.design.fabric, self.factor
        k1, k2 = (factor["membrane"] * k for k in fabric.membrane_stiffness)
        b1, b2 = (factor["bending"] * b for b in fabric.bending_stiffness)
        nu12, nu21 = fabric.poisson, fabric.poisson * k2 / k1
        plate = 1 - nu12 * nu21
        self.k = k1 / plate, k2 / plate, nu21 * k1 / plate  # equation 2
        self.b = b1, b2
        self.d = b1 / plate, b2 / plate, np.sqrt(nu12 * nu21 * b1 * b2) / plate  # equation 5
        self.shear = factor["shear"] * fabric.shear_stiffness
        twist = fabric.twist_stiffness
        self.twist = np.sqrt(b1 * b2) / (1 + np.sqrt(nu12 * nu21)) if twist is None else factor["bending"] * twist
        self.viscosity, self.air = factor["damping"] * fabric.viscosity, factor["damping"] * fabric.air_damping
        self.gravity = np.array(fabric.gravity)

    # --- the cloth: equations 1 to 6

    def edge_strains(self, x, direction):
        start, end, _ = self.edges[direction]
        tangent, length = unit(x[end] - x[start])
        g = tangent / self.h[direction]
        return Terms(np.stack([start, end], 1), length / self.h[direction] - 1, np.stack([-g, g], 1)), tangent, length

    def _cell_tangents(self, x):
        along_u, along_v = np.array([-0.5, 0.5, -0.5, 0.5]), np.array([-0.5, -0.5, 0.5, 0.5])
        corners = x[self.corners]
        return along_u, along_v, np.einsum("k,mkc->mc", along_u, corners), np.einsum("k,mkc->mc", along_v, corners)

    def shear_angles(self, x):
        along_u, along_v, a, b = self._cell_tangents(x)
        (s, la), (t, lb) = unit(a), unit(b)
        angle = np.sum(s * t, axis=1)
        ga, gb = (t - angle[:, None] * s) / la[:, None], (s - angle[:, None] * t) / lb[:, None]
        return Terms(self.corners, angle, along_u[:, None] * ga[:, None] + along_v[:, None] * gb[:, None])

    def twists(self, x):
        along_u, along_v, a, b = self._cell_tangents(x)
        normal, size = unit(np.cross(b, a))
        signs = np.array([1.0, -1.0, -1.0, 1.0])
        mixed = np.einsum("k,mkc->mc", signs, x[self.corners]) / self.cell
        side = across(mixed, normal) / size[:, None]
        gradient = signs[:, None] * normal[:, None] / self.cell
        gradient = (
            gradient + along_u[:, None] * np.cross(side, b)[:, None] + along_v[:, None] * np.cross(a, side)[:, None]
        )
        return Terms(self.corners, np.sum(normal * mixed, axis=1), gradient)

    def curvatures(self, x, direction):
        """At every node; zero with zero gradient where the direction has no two edges. Nodes: itself, W, E, N, S."""
        (west, east), (north, south) = self.neighbours
        a, b = x[east] - x[west], x[south] - x[north]
        normal, size = unit(np.cross(b, a))
        lower, upper = self.neighbours[direction]
        m = np.flatnonzero(self.inner[direction])
        nm, h = normal[m], self.h[direction]
        turning = (x[upper[m]] - 2 * x[m] + x[lower[m]]) / h
        side = across(turning, nm) / size[m, None]
        ga = gb = nm / h
        value, gradient = np.zeros(len(x)), np.zeros((len(x), 5, 3))
        value[m] = np.sum(nm * turning, axis=1) / h
        low, high = (1, 2) if direction == 0 else (3, 4)
        gradient[m, 0] -= (ga + gb) / h
        gradient[m, high] += ga / h
        gradient[m, low] += gb / h
        along_a, along_b = np.cross(side, b[m]) / h, np.cross(a[m], side) / h
        gradient[m, 2] += along_a
        gradient[m, 1] -= along_a
        gradient[m, 4] += along_b
        gradient[m, 3] -= along_b
        return Terms(np.stack([np.arange(len(x)), west, east, north, south], 1), value, gradient)

    def held_normal(self, x):
        """Half a cell of bending at a clamped top edge; its normal stays (0, 0, 1)."""
        top, below = self.nodes[0], self.nodes[1]
        tangent, length = unit(x[below] - x[top])
        normal = np.array([0, 0, 1.0])
        g = across(np.broadcast_to(normal, tangent.shape), tangent) / length[:, None] * 2 / self.h[1]
        return Terms(np.stack([top, below], 1), tangent @ normal * 2 / self.h[1], np.stack([-g, g], 1))

    # --- muscles: equations 7 to 10

    def _line(self, t, direction):
        """(n,) weights and their derivatives of a loop at `t`: a cubic B-spline with knots LOOP apart over the nodes,
        ghosts included, of a spacing on a coarser grid; mixed with Catmull-Rom interpolation so that the variance is
        (LOOP^2 + WIDENED h^2) / 3."""
        n, h, beyond = self.n, self.h[direction], 8
        x = (np.arange(-beyond, n + beyond) * h - t) / h
        s = max(1.0, LOOP / h)
        assert abs(s - round(s)) < 1e-9
        share = ((LOOP / h) ** 2 + WIDENED) / s**2
        value = catmull_rom(x) + share * (bspline(x / s) / s - catmull_rom(x))
        slope = catmull_rom_slope(x) + share * (bspline_slope(x / s) / s**2 - catmull_rom_slope(x))
        ghosts = np.zeros((n + 2 * beyond, n))  # the quadratic of the last three nodes goes on
        ghosts[beyond:-beyond] = np.eye(n)
        for k in range(1, beyond + 1):
            ghosts[beyond - k, :3] = np.linalg.solve(np.vander([0, 1, 2], increasing=True).T, (1, -k, k * k))
        ghosts[-beyond:, -3:] = ghosts[:beyond, :3][::-1, ::-1]
        return value @ ghosts, slope @ ghosts / h

    def _lace(self):
        position, along_u, along_v, offset, intervals, rest, channel, kind = [], [], [], [], [], [], [], []
        for muscle in self.design.muscles:
            type_ = self.design.muscle_types[muscle.type]
            points = muscle.fixed_points()
            for u, v in points:
                (wu, du), (wv, dv) = self._line(u, 0), self._line(v, 1)
                position.append(np.outer(wv, wu).ravel())
                along_u.append(np.outer(wv, du).ravel())
                along_v.append(np.outer(dv, wu).ravel())
                offset.append((1 if muscle.side == "front" else -1) * type_.axis_offset * self.factor["axis_offset"])
            first = len(position) - len(points)
            for k, (p, q) in enumerate(pairwise(points)):
                intervals.append((first + k, first + k + 1))
                rest.append(np.linalg.norm(q - p))
                channel.append(muscle.channel)
                kind.append(muscle.type)
            for p, q in pairwise(np.array(muscle.path)):
                self._add_line_mass(p, q, type_.mass_per_length)
        self.intervals, self.length, self.channel, self.kind = (
            np.array(intervals),
            np.array(rest),
            np.array(channel),
            kind,
        )
        if intervals:
            self.at, self.at_u, self.at_v = (sp.csr_matrix(np.array(w)) for w in (position, along_u, along_v))
            self.offset = np.array(offset)[:, None]
        self.laws = {name: MuscleLaw.fit(self.design.muscle_types[name].bench) for name in set(kind)}

    def _add_line_mass(self, p, q, density):
        samples = 200
        for t in (np.arange(samples) + 0.5) / samples:
            x = (p + (q - p) * t) / self.h
            i, j = np.clip(x.astype(int), 0, self.n - 2)
            a, b = x - (i, j)
            share = np.outer((1 - b, b), (1 - a, a)) * density * np.linalg.norm(q - p) / samples
            self.mass[self.nodes[j : j + 2, i : i + 2]] += share

    def tensions(self, contraction, pressure):
        """(intervals,) N of the bench law, its gain on what pressure adds."""
        out, kinds = np.empty(len(contraction)), np.array(self.kind)
        pressure = self.acting(np.asarray(pressure, float))
        for name, law in self.laws.items():
            of_kind = kinds == name
            idle = law.tension(0.0, contraction[of_kind])
            full = law.tension(pressure[of_kind], contraction[of_kind])
            out[of_kind] = idle + self.factor["muscle_gain"] * (full - idle)
        return out

    def acting(self, pressure):
        """(intervals,) Pa in the muscles, from (channels,) Pa."""
        return pressure[self.channel]

    def viscosities(self, rate):
        """(intervals,) N s, at contraction rates `rate`."""
        return self.factor["damping"] * np.array([self.design.muscle_types[k].viscosity for k in self.kind])

    def remember(self, pressure):
        """At a step's end; this cloth has no memory."""

    def muscles(self, x, velocity, pressure, cv):
        """Force on the nodes (N, 3), Jacobian (intervals, 3 N) of interval lengths and their stiffness [N/m]."""
        a, b = self.at_u @ x, self.at_v @ x
        normal, size = unit(np.cross(b, a))
        points = self.at @ x + self.offset * normal
        da, db = self.at_u @ velocity, self.at_v @ velocity
        turn = across((np.cross(db, a) + np.cross(b, da)) / size[:, None], normal)
        rates = self.at @ velocity + self.offset * turn
        start, end = self.intervals.T
        direction, length = unit(points[end] - points[start])
        self.contraction = 1 - length / self.length
        shortening = -np.sum(direction * (rates[end] - rates[start]), axis=1) / self.length
        viscosity = self.viscosities(shortening)
        self.tension = self.tensions(self.contraction, pressure) - viscosity * shortening

        def to_nodes(force):
            side = self.offset * across(force, normal) / size[:, None]
            return self.at.T @ force + self.at_u.T @ np.cross(side, b) + self.at_v.T @ np.cross(a, side)

        jacobian = np.zeros((len(length), len(x), 3))
        for k in range(len(length)):
            pull = np.zeros_like(points)
            pull[start[k]], pull[end[k]] = -direction[k], direction[k]
            jacobian[k] = to_nodes(pull)
        step = 1e-4
        slope = self.tensions(self.contraction - step, pressure) - self.tensions(self.contraction + step, pressure)
        stiffness = (slope / (2 * step) + viscosity * cv) / self.length
        force = -np.einsum("k,knc->nc", self.tension, jacobian)
        return force, sp.csr_matrix(jacobian.reshape(len(length), -1)), stiffness

    # --- all of it

    def energy(self, x):
        """Elastic energy of the cloth [J], equations 1 to 6."""
        e1, e2 = (self.edge_strains(x, d)[0].value for d in (0, 1))
        m1, m2 = e1[self.cell_edges[0]].mean(1), e2[self.cell_edges[1]].mean(1)
        c1, c2 = (self.curvatures(x, d).value for d in (0, 1))
        d1, d2, d12 = self._plate()
        total = 0.5 * self.k[0] * self.edges[0][2] @ e1**2 + 0.5 * self.k[1] * self.edges[1][2] @ e2**2
        total += self.cell * np.sum(self.k[2] * m1 * m2)
        total += self.cell * np.sum(0.5 * self.shear * self.shear_angles(x).value ** 2)
        total += self.cell * np.sum(self.twist * self.twists(x).value ** 2)
        total += self.area @ (0.5 * d1 * c1**2 + 0.5 * d2 * c2**2 + d12 * c1 * c2)
        if self.design.fabric.support == "clamped":
            total += 0.5 * np.sum(self._held_weight() * self.held_normal(x).value ** 2)
        return float(total)

    def _plate(self):
        both = self.inner[0] & self.inner[1]
        return (
            np.where(both, self.d[0], self.b[0]) * self.inner[0],
            np.where(both, self.d[1], self.b[1]) * self.inner[1],
            np.where(both, self.d[2], 0.0),
        )

    def _held_weight(self):
        return self.b[1] * self.area[self.nodes[1]] * 0.5

    def evaluate(self, x, velocity, pressure, cv=0.0):
        """Force on the nodes (N, 3) without inertia, and the Gauss-Newton stiffness; cv = d velocity / d x."""
        size, force, stiffness = x.size, np.zeros_like(x), 0

        def add(terms, stress, weight):
            nonlocal stiffness
            np.add.at(force, terms.nodes, -stress[:, None, None] * terms.gradient)
            jacobian = terms.jacobian(size)
            stiffness = stiffness + jacobian.T @ sp.diags(weight) @ jacobian

        strains = [self.edge_strains(x, d) for d in (0, 1)]
        mean = [strains[d][0].value[self.cell_edges[d]].mean(1) for d in (0, 1)]
        for d, (terms, tangent, length) in enumerate(strains):
            area = self.edges[d][2]
            stress = area * (self.k[d] * terms.value + self.viscosity * terms.rate(velocity))
            np.add.at(stress, self.cell_edges[d].ravel(), np.repeat(self.k[2] * mean[1 - d] * self.cell / 2, 2))
            add(terms, stress, area * (self.k[d] + self.viscosity * cv))
            stiffness = stiffness + _tangential(terms, tangent, np.maximum(stress, 0) / self.h[d] / length, size)
        terms = self.shear_angles(x)
        stress = self.cell * (self.shear * terms.value + 0.5 * self.viscosity * terms.rate(velocity))
        add(terms, stress, np.full(len(stress), self.cell * (self.shear + 0.5 * self.viscosity * cv)))
        terms = self.twists(x)
        add(terms, 2 * self.twist * self.cell * terms.value, np.full(len(terms.value), 2 * self.twist * self.cell))
        first, second = self.curvatures(x, 0), self.curvatures(x, 1)
        d1, d2, d12 = self._plate()
        add(first, self.area * (d1 * first.value + d12 * second.value), self.area * d1)
        add(second, self.area * (d2 * second.value + d12 * first.value), self.area * d2)
        if self.design.fabric.support == "clamped":
            terms = self.held_normal(x)
            add(terms, self._held_weight() * terms.value, self._held_weight())
        force += self.mass[:, None] * self.gravity - self.air * self.area[:, None] * velocity
        stiffness = stiffness + sp.diags(np.repeat(self.air * self.area * cv, 3))
        if len(self.length):
            extra, jacobian, axial = self.muscles(x, velocity, pressure, cv)
            force += extra
            stiffness = stiffness + jacobian.T @ sp.diags(axial) @ jacobian
        return force, stiffness

    def equilibrium(self, pressure: Sequence[float] = (), *, start=None, residual=1e-8):
        """Positions at rest: Newton with a fading proximal mass and steps of 10 mm at most, which far from rest may
        raise the residual; from the 30th on they halve until it falls. residual: the largest nodal force [N]."""
        x = self.rest.copy() if start is None else start.copy()
        still, pull, pressure = np.zeros_like(x), 1e4, np.asarray(pressure, float)
        free = np.repeat(self.free, 3)
        force, stiffness = self.evaluate(x, still, pressure)
        for k in range(200):
            size = np.linalg.norm(force[self.free])
            matrix = (stiffness + sp.diags(np.repeat(pull * self.mass, 3)))[free][:, free]
            update = np.zeros_like(x)
            update[self.free] = spsolve(matrix.tocsc(), force.ravel()[free]).reshape(-1, 3)
            share = min(1.0, 0.01 / np.abs(update).max())
            force, stiffness = self.evaluate(x + share * update, still, pressure)
            while k >= 30 and share > 1 / 64 and np.linalg.norm(force[self.free]) > size * (1 + 1e-9):
                share /= 2
                force, stiffness = self.evaluate(x + share * update, still, pressure)
            x += share * update
            pull = max(pull / 2, 10.0)
            if np.abs(force[self.free]).max() < residual:
                return x
        raise RuntimeError(f"no equilibrium: {np.abs(force[self.free]).max():.2g} N left")

    def motion(
        self, pressure: Callable[[float], Sequence[float]], h: float, steps: int, *, rho: float, start, jumps=()
    ):
        """(steps + 1, N, 3) by generalised-alpha, by the midpoint rule in the steps `jumps`; `pressure(t)` holds during
        the step around t."""
        x, v, a, mass = start.copy(), np.zeros_like(start), np.zeros_like(start), self.mass[:, None]
        free, frames = np.repeat(self.free, 3), [start.copy()]
        for k in range(steps):
            p, y = np.asarray(pressure((k + 0.5) * h), float), x + h * v * self.free[:, None]
            am, af = (0.0, 0.5) if k in jumps else ((2 * rho - 1) / (rho + 1), rho / (rho + 1))
            gamma, beta = (1.0, 0.5) if k in jumps else (0.5 - am + af, 0.25 * (1 - am + af) ** 2)
            for _ in range(50):
                a1 = (y - x - h * v) / (beta * h * h) - (0.5 / beta - 1) * a
                v1 = v + h * ((1 - gamma) * a + gamma * a1)
                force, stiffness = self.evaluate((1 - af) * y + af * x, (1 - af) * v1 + af * v, p, gamma / (beta * h))
                r = force - mass * ((1 - am) * a1 + am * a)
                inertia = np.repeat(self.mass * (1 - am) / (beta * h * h), 3)
                matrix = ((1 - af) * stiffness + sp.diags(inertia))[free][:, free]
                update = spsolve(matrix.tocsc(), r.ravel()[free]).reshape(-1, 3)
                y[self.free] += update
                if np.abs(update).max() < 1e-9:
                    break
            a1 = ((y - x - h * v) / (beta * h * h) - (0.5 / beta - 1) * a) * self.free[:, None]
            x, v, a = y, (v + h * ((1 - gamma) * a + gamma * a1)), a1
            self.remember(p)
            frames.append(x.copy())
        return np.array(frames)


def _tangential(terms, tangent, weight, size):
    """Stiffness of tensioned edges against turning: weight (I - t t^T) between both ends."""
    block = weight[:, None, None] * (np.eye(3) - tangent[:, :, None] * tangent[:, None, :])
    signs = np.array([[1, -1], [-1, 1]])
    values = signs[None, :, :, None, None] * block[:, None, None]
    index = 3 * terms.nodes[..., None] + np.arange(3)
    rows = np.broadcast_to(index[:, :, None, :, None], values.shape)
    columns = np.broadcast_to(index[:, None, :, None, :], values.shape)
    return sp.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))
