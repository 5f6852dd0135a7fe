"""Everything a motion needs, as arrays: built from a design, then changed by effects, then run.

All values are SI. An effect edits these fields (or adds to the lists of hooks) before the run; with none, the scene
is the declared design times the parameter factors.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from fabdesign.geometry.hung_cloth import on_flat_cloth
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import PARAMETERS
from fabdesign.nouns.muscle_law import law_of
from studies.rig.cables import CONTRACTIONS, PRESSURE_STEP, Cables
from studies.rig.shell import Axis, Patch

IMPERFECTION = 1e-4  # 1/m, rest curvature by the seed: 2 um over 0.2 m, decides which way a symmetric cloth buckles
PIN_STIFFNESS = 2e5  # N/m, of a hung point's spring: 0.01 mm under the cloth's weight


@dataclass(frozen=True)
class Resolution:
    """Mesh and time step. The default's distance from the limit stands in docs/lab/rig.md."""

    element: float = 0.008  # m: of 10 mm, crosses that snap were up to 1.7 mm off, of 8 mm 0.2 mm
    degree: int = 3  # of the splines; quadratic ones of 10 mm are four times farther off than cubic ones
    step: float = 1 / 960  # s: with 1 / 480 up to 0.5 mm


DEFAULT = Resolution()


class MuscleState:
    """Per interval of the cables (n,) or per channel; scalars where marked. The values here switch effects off."""

    def __init__(self, gain: float, viscosity: Array) -> None:
        count = len(viscosity)
        self.gain = np.full(count, gain)  # factor on the active tension
        self.pressure_factor = np.ones(count)  # of the channel's pressure that reaches the interval
        self.threshold = self.threshold_width = 0.0  # Pa
        self.viscosity = viscosity  # N s, while contracting
        self.viscosity_out = viscosity.copy()  # N s, while lengthening
        self.creep = np.zeros(count)  # contraction that the law does not see
        self.friction_per_pressure = 0.0  # N/Pa, Coulomb limit of the braid
        self.friction_at_zero = 0.0  # N
        self.friction_slip = 0.01  # contraction over which the friction builds up
        self.friction = np.zeros(count)  # N, its present value
        self.contraction_before = np.zeros(0)  # at the last step


class Scene:
    """A declared design as arrays, with n control points and q quadrature points of the cloth."""

    def __init__(
        self,
        design: Design,
        factors: Mapping[str, float],
        resolution: Resolution,
        *,
        max_pressure: float,
        seed: int = 0,
    ) -> None:
        """Take a design's values times `factors`, by the names of nouns.forward.PARAMETERS; max_pressure [Pa] sizes
        tables."""
        f = {name: factors.get(name, 1.0) for name in PARAMETERS}
        cloth, muscles, kinds = design.fabric, design.muscles, design.muscle_types
        across, down = _reach(design)
        axes = [
            Axis(np.linspace(0.0, length, _elements(length, resolution) + 1), resolution.degree)
            for length in (cloth.width, cloth.height)
        ]
        self.design = design
        self.patch = Patch(axes[0], axes[1], u_slow=bool(across <= down))  # muscles stay within a block: a narrow band
        self.uv, self.weight = self.patch.quadrature()  # (q, 2) m, quadrature points; (q,) m^2
        moduli = _moduli(design, f["membrane"], f["shear"], f["bending"])
        # (q, 8): membrane 11, 12, 22, shear; bending 11, 12, 22, twist
        self.stiffness = np.tile(moduli, (len(self.uv), 1))
        curvature = _imperfection(self.uv, cloth.width, cloth.height, seed)
        self.rest_strain = np.concatenate([np.zeros_like(curvature), curvature], axis=1)  # (q, 6)
        self.viscosity = np.full(len(self.uv), cloth.viscosity * f["damping"])  # (q,) N s/m
        unit = self.patch.matrix(self.uv)
        area = (unit.T @ sp.diags(self.weight) @ unit).tocsr()
        threads = sp.csr_matrix((self.patch.count, self.patch.count))
        for each in muscles:
            threads = threads + line_mass(self.patch, np.array(each.path), kinds[each.type].mass_per_length)
        self.mass = (cloth.areal_density * f["areal_density"] * area + threads).tocsr()  # (n, n) kg
        self.drag = (cloth.air_damping * f["damping"] * area).tocsr()  # (n, n) N s/m
        self.gravity = np.array(cloth.gravity, dtype=float)  # (3,)
        self.cables = Cables(design, self.patch, f["axis_offset"])
        each_interval = [muscles[m] for m in self.cables.muscle]
        viscosity = np.array([kinds[muscle.type].viscosity * f["damping"] for muscle in each_interval])
        self.muscle_state = MuscleState(f["muscle_gain"], viscosity)
        pressures = np.arange(0.0, max_pressure + 2 * PRESSURE_STEP, PRESSURE_STEP)
        tables = [law_of(kind.bench).tension(pressures[:, None], CONTRACTIONS) for kind in kinds.values()]
        # (types, pressures, CONTRACTIONS) N, tension; (intervals,) which of them
        self.tables = np.array(tables).reshape(len(kinds), len(pressures), len(CONTRACTIONS))
        self.law = np.array([[*kinds].index(muscle.type) for muscle in each_interval], dtype=np.int64)
        self.channel = np.array([muscle.channel for muscle in each_interval], dtype=np.int64)  # (intervals,)
        self.held, hung_uv = _support(design, self.patch)  # (n, 3) control values that do not move
        self.ties = self.patch.matrix(hung_uv)  # (points, n) that are tied by springs of no length
        self.tie_stiffness = np.full(len(hung_uv), PIN_STIFFNESS)  # (points,) N/m
        self.tied_to = on_flat_cloth(hung_uv, cloth)  # (points, 3) m
        self.prony, self.prony_time = 0.0, 1.0  # share of the cloth's stress that relaxes; s
        self.pressure_hooks: list[Callable[[Array, float], Array]] = []  # (steps, channels), h -> same
        self.loads: list[Callable[[float, Array, Array], Array]] = []  # t, x, v -> force (n, 3)
        self.sensed: list[Callable[[Array], Array]] = []  # (n, 3) m -> what the sensor says
        self.time_shift = 0.0  # s that the sensor's clock is late
        self.after_step: list[Callable[[Scene, StepReport], None]] = []


@dataclass(frozen=True)
class StepReport:
    """A finished step, as hooks get it."""

    time: float  # s
    step: float  # s
    pressure: Array  # (intervals,) Pa
    contraction: Array  # (intervals,)
    tension: Array  # (intervals,) N
    strain: Array  # (q, 6)


Apply = Callable[[Scene, int, Mapping[str, float]], None]
Change = Callable[[Array, float, Mapping[str, float]], Array]


@dataclass(frozen=True)
class RigEffect:
    """`apply(scene, order, values)` edits the scene; order is the trial's place in the specimen's session."""

    site: str
    parameters: Mapping[str, tuple[float, str]]  # name -> default, unit
    apply: Apply


EFFECTS: dict[str, RigEffect] = {}


def effect(site: str, **parameters: tuple[float, str]) -> Callable[[Apply], Apply]:
    """Declare a function as the effect of its name."""

    def declared(apply: Apply) -> Apply:
        EFFECTS[apply.__name__] = RigEffect(site, parameters, apply)
        return apply

    return declared


def pressure_effect(**parameters: tuple[float, str]) -> Callable[[Change], Apply]:
    """Declare a function as the effect of its name on the channels' pressures (steps, channels) Pa."""

    def declared(change: Change) -> Apply:
        @wraps(change)
        def apply(scene: Scene, order: int, values: Mapping[str, float]) -> None:
            scene.pressure_hooks.append(lambda pressure, step: change(pressure, step, values))

        return effect("pneumatics", **parameters)(apply)

    return declared


def control_counts(design: Design, resolution: Resolution) -> tuple[int, int]:
    """Return of the patch how many control points, and how many pairs of them are in reach of each other at most."""
    fabric, reach = design.fabric, _reach(design)
    sizes = (fabric.width, fabric.height) if reach[0] <= reach[1] else (fabric.height, fabric.width)
    blocks, within = (_elements(length, resolution) + resolution.degree for length in sizes)
    reached = min(blocks, int(min(reach) / resolution.element) + resolution.degree + 1)
    return blocks * within, blocks * within**2 * reached


def _elements(length: float, resolution: Resolution) -> int:
    return max(3, round(length / resolution.element))


def _reach(design: Design) -> tuple[float, float]:
    """Return m across and down between neighbouring fixed points at most."""
    spans = [np.abs(np.diff(m.fixed_points(), axis=0)).max(axis=0) for m in design.muscles]
    across, down = np.max(spans, axis=0) if spans else (0.0, 0.0)
    return float(across), float(down)


def _moduli(design: Design, membrane: float, shear: float, bending: float) -> Array:
    """Return the plane-stress plate of docs/files.md: k / (1 - nu12 nu21) and nu12 / k1 = nu21 / k2, the same for B."""
    cloth = design.fabric
    k1, k2 = (membrane * k for k in cloth.membrane_stiffness)
    b1, b2 = (bending * b for b in cloth.bending_stiffness)
    nu2 = cloth.poisson**2 * k2 / k1  # nu12 nu21
    q = 1.0 - nu2
    twist = cloth.twist_stiffness
    twist = (b1 * b2) ** 0.5 / (1.0 + nu2**0.5) if twist is None else twist * bending
    nu = np.sign(cloth.poisson) * nu2**0.5
    membrane_moduli = k1 / q, nu * (k1 * k2) ** 0.5 / q, k2 / q, shear * cloth.shear_stiffness
    return np.array([*membrane_moduli, b1 / q, nu * (b1 * b2) ** 0.5 / q, b2 / q, twist])


def line_mass(patch: Patch, path: Array, per_length: float) -> sp.csr_matrix:
    """Return the mass matrix of a thread along a polyline (n, 2) m."""
    g, w = np.polynomial.legendre.leggauss(3)
    total = sp.csr_matrix((patch.count, patch.count))
    for a, b in pairwise(path):
        pieces = max(1, round(float(np.linalg.norm(b - a)) / 0.004))
        ends = np.linspace(0.0, 1.0, pieces + 1)
        s = (ends[:-1, None] + (g + 1) / 2 / pieces).ravel()
        basis = patch.matrix(a + (b - a) * s[:, None])
        weight = np.tile(w / 2 / pieces, pieces) * np.linalg.norm(b - a) * per_length
        total = total + basis.T @ sp.diags(weight) @ basis
    return total.tocsr()


def _support(design: Design, patch: Patch) -> tuple[NDArray[np.bool_], Array]:
    """Return the control values that are held, for a hung edge; (points, 2) m to be tied, where the cloth hangs by
    points."""
    held = np.zeros((patch.count, 3), dtype=bool)
    hung = design.fabric.hung
    if isinstance(hung, tuple):
        return held, np.array(hung)
    if hung != "none":
        gu, gv = np.meshgrid(np.arange(patch.u.count), np.arange(patch.v.count), indexing="ij")
        index = patch.index(gu, gv)
        rows = {"top": index[:, :2], "bottom": index[:, :-3:-1], "left": index[:2].T, "right": index[:-3:-1].T}[hung]
        held[rows[:, 0]] = True
        if design.fabric.support == "clamped":  # the next row stays in the plane: the tangent plane holds
            held[rows[:, 1], 2] = True
    return held, np.zeros((0, 2))


def _imperfection(uv: Array, width: float, height: float, seed: int) -> Array:
    """Return (n, 3) rest curvatures [1/m]: a few long waves with amplitudes by the seed."""
    rng = np.random.default_rng([seed, 7])
    s, t = uv[:, 0] / width, uv[:, 1] / height
    waves = np.stack([np.ones_like(s), np.cos(np.pi * s), np.cos(np.pi * t), np.cos(np.pi * s) * np.cos(np.pi * t)])
    return IMPERFECTION * (rng.normal(size=(3, 4)) @ waves).T / 2
