"""The reference motion by MuJoCo's flex: the same cloth and muscles as closely as its elements allow.

Two flexes share the nodes, one that stretches (triangles, diagonals in turn) and one that bends, since one thickness
cannot give both stiffnesses. Its material is isotropic: shear is k / (2 (1 + nu)), not the declared 130 N/m, and
bending has no twist of its own. Nodes have no rotation, so a muscle's fixed point is a small mass at its distance from
the cloth, held by upright triangles on the four next nodes; it lies at the node next to where it should, and carries
its share of the muscle's mass. An interval between two of them is a spatial tendon with an actuator whose force is
linear in contraction and in pressure, fitted to the bench table. There are no contacts, and so no constraints: a step
is the one linear solve of `integrator="discrete"`, alike with Newton and CG. It converges in some hundred iterations;
50 leave a motion at 4 substeps as large an error and at 8 one a tenth larger, in half the time (20 leave twice the
error): timed runs take 50.
"""

import itertools
import time
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.sim.cases import FRAME
from fabdesign.nouns.forward import Case
from fabdesign.nouns.muscle import BenchTable, MuscleType

version: str = mujoco.__version__
ARM = 5e3  # N/m, membrane stiffness of the triangles that hold a fixed point: ten times the cloth's
ARM_DAMPING = 1e-3  # s
CHEAP, CONVERGED = 50, 500  # iterations of a step's linear solve
SETTLE = 2.0  # s under weight, in air ten times as thick, before the motion; not timed


@dataclass(frozen=True)
class FlexMotion:
    nodes: NDArray[np.float64]  # (frames, n n, 3) m
    rest: NDArray[np.float64]  # (n n, 3) m, before
    cpu: float  # s, of all frames
    warnings: int  # steps in which its solve ran out of iterations


def motion(case: Case, times: NDArray[np.float64], *, n: int, substeps: int, iterations: int) -> FlexMotion:
    """Frames at `times`, multiples of FRAME, with `substeps` steps between two of them."""
    mujoco.set_mju_user_warning(lambda _: None)  # would write a file; counted instead
    model = mujoco.MjModel.from_xml_string(scene(case, n, FRAME))
    model.opt.iterations = iterations
    data = mujoco.MjData(model)
    channels = [m.channel for m in case.design.muscles for _ in range(len(m.fixed_points()) - 1)]
    # a node of a flex takes no joint damping; a force of the step's first velocity will do for 1 / s
    rate = case.design.fabric.air_damping / case.design.fabric.areal_density
    drag = rate * model.dof_M0
    for _ in range(round(SETTLE / FRAME)):
        data.qfrc_applied[:] = -10 * drag * data.qvel
        mujoco.mj_step(model, data)
    data.qvel[:] = 0
    rest = data.xpos[1 : n * n + 1].copy()
    model.opt.timestep = FRAME / substeps
    before = _warnings(data)
    nodes, begin = [], time.process_time()
    for frame in range(round(times[-1] / FRAME)):
        for substep in range(substeps):
            data.ctrl[:] = case.program.at(np.array([(frame + (substep + 0.5) / substeps) * FRAME]))[0][channels]
            data.qfrc_applied[:] = -drag * data.qvel
            mujoco.mj_step(model, data)
        nodes.append(data.xpos[1 : n * n + 1].copy())
    cpu = time.process_time() - begin
    return FlexMotion(np.array(nodes), rest, cpu, _warnings(data) - before)


def _warnings(data: mujoco.MjData) -> int:
    return int(data.warning[mujoco.mjtWarning.mjWARN_INERTIA].number)


def scene(case: Case, n: int, step: float) -> str:
    """The model as MJCF."""
    fabric = case.design.fabric
    h = fabric.width / (n - 1)
    share = np.outer(*[np.r_[0.5, np.ones(n - 2), 0.5]] * 2).ravel() * h * h
    bodies = [
        _node(f"n{k}", (k % n * h, -(k // n) * h, 0.0), share[k] * fabric.areal_density, free=k >= n)
        for k in range(n * n)
    ]
    arms: list[str] = []
    tendons, actuators, tips = [], [], 0
    for muscle in case.design.muscles:
        kind = case.design.muscle_types[muscle.type]
        side = kind.axis_offset * (1 if muscle.side == "front" else -1)
        places = [(round(v / h), round(u / h)) for u, v in muscle.fixed_points()]
        for k, (j, i) in enumerate(places):
            intervals = 1.0 if 0 < k < len(places) - 1 else 0.5
            mass = kind.mass_per_length * muscle.length / (len(places) - 1) * intervals
            bodies.append(_node(f"t{tips + k}", (i * h, -j * h, side), mass, free=True))
            arms.append(f"t{tips + k} " + " ".join(f"n{(j + a) * n + i + b}" for a, b in _CROSS))
        for k in range(len(places) - 1):
            name = f"m{tips + k}"
            tendons.append(f'<spatial name="{name}"><site site="t{tips + k}"/><site site="t{tips + k + 1}"/></spatial>')
            length = h * float(np.hypot(*np.subtract(places[k + 1], places[k])))
            actuators.append(_actuator(name, kind, length))
        tips += len(places)
    stiffness, nu = fabric.membrane_stiffness[0], fabric.poisson
    t = (12 * fabric.bending_stiffness[0] / stiffness) ** 0.5  # any thickness will do: a modulus goes with each flex
    names, elements = " ".join(f"n{i}" for i in range(n * n)), _triangles(n)
    damping = fabric.viscosity * (1 - nu**2) / stiffness
    flexes = [
        _flex("stretch", names, elements, young=stiffness / t, poisson=nu, thickness=t, damping=damping),
        _flex("bend", names, elements, young=stiffness / t * (1 - nu**2), poisson=nu, thickness=t, damping=0.0),
        *(
            _flex("stretch", arm, _UPRIGHT, young=ARM / t, poisson=0.0, thickness=t, damping=ARM_DAMPING)
            for arm in arms
        ),
    ]
    gravity = " ".join(map(str, fabric.gravity))
    return f"""<mujoco>
      <option timestep="{step}" gravity="{gravity}" integrator="discrete" solver="Newton" tolerance="1e-6"
        jacobian="sparse"><flag contact="disable"/></option>
      <worldbody>{"".join(bodies)}</worldbody>
      <deformable>{"".join(flexes)}</deformable>
      <tendon>{"".join(tendons)}</tendon>
      <actuator>{"".join(actuators)}</actuator>
    </mujoco>"""


_CROSS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))  # (row, column) beside a fixed point's node
_UPRIGHT = "0 1 2 0 1 3 0 1 4 0 1 5"  # tip, node, one of the next


def _node(name: str, at: tuple[float, ...], mass: float, *, free: bool) -> str:
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    position = " ".join(f"{x:.9g}" for x in at)
    return (
        f'<body name="{name}" pos="{position}"><inertial pos="0 0 0" mass="{mass:.6g}" diaginertia="1e-9 1e-9 1e-9"/>'
        f'{slides if free else ""}<site name="{name}"/></body>'
    )


def _triangles(n: int) -> str:
    """Two to a cell, diagonals in turn."""
    out = []
    for j, i in itertools.product(range(n - 1), repeat=2):
        a, b, c, d = j * n + i, j * n + i + 1, (j + 1) * n + i, (j + 1) * n + i + 1
        out += [a, c, b, b, c, d] if (i + j) % 2 else [a, c, d, a, d, b]
    return " ".join(map(str, out))


def _flex(
    kind: str, bodies: str, elements: str, *, young: float, poisson: float, thickness: float, damping: float
) -> str:
    return (
        f'<flex dim="2" radius="0.001" body="{bodies}" element="{elements}"><contact selfcollide="none"/>'
        f'<elasticity young="{young:.9g}" poisson="{poisson}" thickness="{thickness:.9g}" damping="{damping:.9g}" '
        f'elastic2d="{kind}"/></flex>'
    )


def law(bench: BenchTable) -> NDArray[np.float64]:
    """a, b, c, d of the tension a + b eps + (c + d eps) p [N, Pa] that fits the table best where eps >= 0."""
    p, e, f = (np.array(x) for x in (bench.pressure, bench.contraction, bench.force))
    columns = np.stack([np.ones_like(p), e, p, e * p], axis=1)
    return np.linalg.lstsq(columns[e >= 0] * [1, 1, 1e-5, 1e-5], f[e >= 0], rcond=None)[0] * [1, 1, 1e-5, 1e-5]


def _actuator(tendon: str, kind: MuscleType, length: float) -> str:
    """Pulls with the law; eps = 1 - l / length. A positive force of an actuator would lengthen its tendon."""
    a, b, c, d = law(kind.bench)
    bias = f"{-a - b:.9g} {b / length:.9g} {-kind.viscosity / length:.9g}"
    gain = f"{-c - d:.9g} {d / length:.9g} 0"
    return (
        f'<general name="{tendon}" tendon="{tendon}" gaintype="affine" gainprm="{gain}" biastype="affine" '
        f'biasprm="{bias}"/>'
    )
