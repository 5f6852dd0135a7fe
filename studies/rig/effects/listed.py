"""Effects of the simulator's list by laws of the rig's own: in muscles, pneumatics, cloth, surroundings, sensors."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from fabdesign.errors import InputError
from fabdesign.nouns.array import Array
from fabdesign.units import from_kpa
from studies.rig.scene import Scene, StepReport, effect, pressure_effect

OPEN = 5e3  # Pa, above which a channel draws from the supply
PATCH_EDGE = 0.004  # m, over which a stiff patch fades out
SLIP_DAMPING = 6.0  # of the muscle's viscosity over interval length; under 3 a step overshoots
LEAST_VISCOSITY = 2.0  # N s
OF_CLOUDS = ("registration_bias", "scale_error")  # they change what is seen of a motion, never the motion


@effect("muscle", threshold=(40.0, "kPa"), width=(10.0, "kPa"))
def threshold_pressure(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """p acts as softplus(p - threshold)."""
    scene.muscle_state.threshold = from_kpa(values["threshold"])
    scene.muscle_state.threshold_width = from_kpa(values["width"])


@effect("muscle", friction=(0.005, "N/kPa"), friction_at_zero=(0.0, "N"), slip=(0.005, "1"))
def braid_hysteresis(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Coulomb friction that grows with pressure: one Maxwell-slip element an interval."""
    scene.muscle_state.friction_per_pressure = values["friction"] / from_kpa(1.0)  # N/Pa
    scene.muscle_state.friction_at_zero = values["friction_at_zero"]
    scene.muscle_state.friction_slip = values["slip"]


@effect("muscle", share=(0.15, "1"), time=(0.8, "s"))
def muscle_creep(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Standard linear solid: part of the contraction is lent by a slow state that the bench law does not see."""

    def creep(scene: Scene, report: StepReport) -> None:
        state = scene.muscle_state
        goal = values["share"] * np.maximum(report.contraction, 0.0)
        state.creep += (goal - state.creep) * -np.expm1(-report.step / values["time"])

    scene.after_step.append(creep)


@effect("muscle", contracting=(20.0, "N s"), lengthening=(10.0, "N s"))
def muscle_viscosity(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Viscosity beyond the declared one, different while contracting and while lengthening."""
    scene.muscle_state.viscosity += values["contracting"]
    scene.muscle_state.viscosity_out += values["lengthening"]


@effect("muscle", loss=(0.15, "1"), trials=(3.0, "1"))
def stroke_softening(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """The active tension falls from trial to trial, by `loss` in the end."""
    scene.muscle_state.gain *= 1.0 - values["loss"] * -np.expm1(-order / values["trials"])


@effect("muscle", channel=(0.0, "1"), factor=(0.8, "1"))
def odd_muscle(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """One channel's muscles pull with another gain."""
    channel = int(values["channel"])
    if channel not in scene.channel:
        raise InputError(f"odd_muscle: channel {channel} has no muscle in design {scene.design.name}")
    scene.muscle_state.gain[scene.channel == channel] *= values["factor"]


@pressure_effect(fill=(0.08, "s"), empty=(0.16, "s"))
def filling_lag(pressure: Array, step: float, values: Mapping[str, float]) -> Array:
    """Return p with dp/dt = (set point - p) / tau, a time constant each for filling and emptying."""
    fill, empty = (-np.expm1(-step / values[k]) for k in ("fill", "empty"))
    out = pressure.copy()
    out[0] = 0.0
    for k in range(1, len(out)):
        gap = pressure[k] - out[k - 1]
        out[k] = out[k - 1] + gap * np.where(gap > 0, fill, empty)
    return out


@pressure_effect(delay=(0.04, "s"))
def dead_time(pressure: Array, step: float, values: Mapping[str, float]) -> Array:
    """Return p(t - delay); zero before."""
    time = np.arange(len(pressure)) * step
    ends = np.searchsorted(time, time - values["delay"] - 1e-9)  # the step in which the earlier instant lies
    return np.asarray(np.where((time > values["delay"] + 1e-9)[:, None], pressure[ends], 0.0))


@pressure_effect(share=(0.05, "1"))
def supply_droop(pressure: Array, step: float, values: Mapping[str, float]) -> Array:
    """Other open channels take a share of a channel's pressure."""
    is_open = pressure > OPEN
    others = is_open.sum(axis=1, keepdims=True) - is_open
    return np.asarray(pressure * np.maximum(1.0 - values["share"] * others, 0.0))


@effect("pneumatics", share=(0.3, "1"))
def line_loss(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Pressure falls linearly along a muscle, from its path's first point to its last."""
    scene.muscle_state.pressure_factor *= 1.0 - values["share"] * scene.cables.along


@effect("fabric", ratio=(2.0, "1"))
def orthotropy(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """k_1 / k_2 and B_1 / B_2 times `ratio`, their products unchanged."""
    root = values["ratio"] ** 0.5
    scene.stiffness[:, [0, 4]] *= root
    scene.stiffness[:, [2, 6]] /= root


@effect("fabric", u=(0.1, "m"), v=(0.1, "m"), radius=(0.03, "m"), factor=(4.0, "1"))
def local_stiffening(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Membrane and bending times `factor` in a disc."""
    distance = np.hypot(scene.uv[:, 0] - values["u"], scene.uv[:, 1] - values["v"])
    inside = 1.0 / (1.0 + np.exp((distance - values["radius"]) / (PATCH_EDGE / 4)))
    scene.stiffness *= (1.0 + (values["factor"] - 1.0) * inside)[:, None]


@effect("fabric", share=(0.3, "1"), time=(0.7, "s"))
def stress_relaxation(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """One Prony term: `share` of the cloth's stress relaxes; declared values are the instantaneous ones."""
    scene.prony, scene.prony_time = values["share"], values["time"]


@effect("fabric", across=(0.0, "1/m"), down=(1.5, "1/m"), twist=(0.0, "1/m"))
def rest_curvature(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """The free cloth is curved; positive curvature bends the hem towards the viewer."""
    scene.rest_strain[:, 3] += values["across"]
    scene.rest_strain[:, 4] += values["down"]
    scene.rest_strain[:, 5] += values["twist"]


@effect("interface", friction=(0.02, "1"), grip=(0.02, "N"))
def loop_slip(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Muscle slides through a fixed point where tensions differ by more than friction times their mean."""
    cables = scene.cables
    upper = np.flatnonzero(np.diff(cables.muscle) == 0)
    lower = upper + 1

    def slip(scene: Scene, report: StepReport) -> None:
        difference = report.tension[lower] - report.tension[upper]
        held = values["friction"] * (np.abs(report.tension[lower]) + np.abs(report.tension[upper])) / 2
        excess = np.sign(difference) * np.maximum(np.abs(difference) - held - values["grip"], 0.0)
        viscosity = np.maximum(scene.muscle_state.viscosity[upper], LEAST_VISCOSITY)
        moved = report.step * excess * cables.rest[upper] / (SLIP_DAMPING * viscosity)
        np.add.at(cables.rest, lower, moved)  # material goes where the tension is higher
        np.add.at(cables.rest, upper, -moved)

    scene.after_step.append(slip)


def load_along_normals(scene: Scene, pressure: Callable[[float, Array, Array], Array]) -> None:
    """Add what acts along the cloth's normals: pressure (q,) Pa of the time [s], and of unit normals towards the front
    and velocities m/s (q, 3) at the quadrature points."""
    value, along_u, along_v = (scene.patch.matrix(scene.uv, *d) for d in ((0, 0), (1, 0), (0, 1)))

    def load(time: float, x: Array, v: Array) -> Array:
        n = np.cross(along_v @ x, along_u @ x)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        return np.asarray(value.T @ ((pressure(time, n, value @ v) * scene.weight)[:, None] * n))

    scene.loads.append(load)


@effect("environment", coefficient=(3.0, "N s^2/m^4"))
def air_drag(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Quadratic drag against the normal velocity: coefficient abs(v_n) v_n per area."""

    def drag(time: float, n: Array, v: Array) -> Array:
        speed = np.einsum("qi,qi->q", v, n)
        return np.asarray(-values["coefficient"] * np.abs(speed) * speed)

    load_along_normals(scene, drag)


@effect("environment", about_x=(3.0, "deg"), about_z=(0.0, "deg"))
def frame_tilt(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """The frame leans: gravity turns about the frame's x and z axes."""
    a, c = np.radians(values["about_x"]), np.radians(values["about_z"])
    turn_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    turn_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    scene.gravity = turn_z @ turn_x @ scene.gravity


@effect("environment", u=(0.15, "m"), v=(0.18, "m"), mass=(0.005, "kg"))
def added_mass(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A mass fixed to one point of the cloth."""
    row = scene.patch.matrix(np.array([[values["u"], values["v"]]]))
    scene.mass = (scene.mass + values["mass"] * (row.T @ row)).tocsr()


@effect(
    "sensing", **{a: (0.003 if a == "z" else 0.0, "m") for a in "xyz"}, **{f"about_{a}": (0.0, "deg") for a in "xyz"}
)
def registration_bias(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Clouds are turned about the world's axes and shifted, always alike."""
    turn = Rotation.from_euler("xyz", [values[f"about_{a}"] for a in "xyz"], degrees=True).as_matrix()
    shift = np.array([values[a] for a in "xyz"])
    scene.sensed.append(lambda points: points @ turn.T + shift)


@effect("sensing", offset=(0.05, "s"))
def time_offset(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """A frame shows the cloth as it was `offset` before the frame's time."""
    scene.time_shift -= values["offset"]


@effect("sensing", scale=(0.02, "1"))
def scale_error(scene: Scene, order: int, values: Mapping[str, float]) -> None:
    """Coordinates are too large by `scale`, from the origin."""
    scene.sensed.append(lambda points: points * (1.0 + values["scale"]))
