"""The virtual rig's sets on which traces are judged, and what is right on each.

Rigs of a catalogue layout, their factors drawn from calibration's prior; six trials of 1.5 s at 30 Hz (a step on and
off, a staircase, a ramp, channels in turn, random levels twice), the last of role test. Kinds: one effect of the list
at two sizes, or by another law (docs/rig.md), right where it is named; none; several at once; outside the list, or
withheld from it, right where it is called unexplained or a look-alike is named that says so; a drift over the session
that the list does not have, right where it is not called adequate; all of these but the drift on programs that hold, as
docs/trace.md asks for: trials of 3 s, every level held for 0.75 s or more.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.nouns.array import Array
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import PARAMETERS
from fabdesign.nouns.pressure import PressureProgram
from optimize.fit.parameters import PRIOR
from studies.rig import EffectSetting, RigSession, run_rig
from studies.rig.effects.unlisted import OF
from studies.rig.scene import Resolution
from studies.rig.specimen import GroundTruth, TrialTask, control_points, prepare

SECONDS = 1.5
HIGHEST = 350e3  # Pa
NULLS = 24  # sets without an effect
LOOK_ALIKE = {"wind": "frame_tilt"}  # an effect that says of itself that the other looks the same


@dataclass(frozen=True)
class Rig:
    """A specimen. kind: "one", "none", "several", "outside", "withheld", "drift" or "held". layout: name and number of
    muscles. effects: by name, their values."""

    kind: str
    name: str
    layout: tuple[str, int]
    seed: int
    effects: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def right(self) -> str:
        """The verdict, or the effects' names."""
        if self.kind == "drift":
            return "not adequate"
        if self.kind == "withheld" or not {*self.effects}.isdisjoint(UNLISTED):
            return "unexplained"
        return " + ".join(OF.get(e, e) for e in self.effects) or "adequate"

    @property
    def withheld(self) -> str | None:
        """The effect that the trace does not know."""
        return next((OF.get(name, name) for name in self.effects if self.kind == "withheld"), None)

    @property
    def design(self) -> Design:
        return build(self.layout[0], muscles=self.layout[1])

    @property
    def factors(self) -> dict[str, float]:
        rng = np.random.default_rng(self.seed)
        return {name: float(np.exp(PRIOR[name] * np.clip(rng.standard_normal(), -2, 2))) for name in PARAMETERS}

    @property
    def truth(self) -> GroundTruth:
        effects = tuple(EffectSetting(name, values) for name, values in self.effects.items())
        return GroundTruth(self.seed, self.factors, effects)

    @property
    def put_in(self) -> str:
        """For people."""
        phrases = [f"{e} ({', '.join(f'{name} {x:g}' for name, x in v.items())})" for e, v in self.effects.items()]
        return ", ".join(phrases) or "nothing"

    def is_right(self, names: Sequence[str], verdict: str, indistinguishable: Sequence[str]) -> bool:
        """Whether a trace's answer is: effects found, verdict, and names that it could not tell from the last."""
        if self.kind == "drift":
            return verdict != "adequate"
        if self.right in ("adequate", "unexplained"):
            alike = [LOOK_ALIKE.get(name, "") for name in self.effects]
            return verdict == self.right or (self.right == "unexplained" and [*names] == alike)
        wanted = set(self.right.split(" + "))
        return wanted == {*names} or (len(wanted) == len(names) == 1 and wanted <= {*indistinguishable})


VERTICAL, SIDE, CROSS, BASIC = ("vertical", 3), ("side", 4), ("cross", 2), ("basic", 4)
LAYOUTS = VERTICAL, SIDE, CROSS, BASIC
# of each effect its values, and those that the larger size has instead
SIZES: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "threshold_pressure": ({"threshold": 20.0, "width": 10.0}, {"threshold": 60.0}),
    "braid_hysteresis": ({"friction": 0.01, "slip": 0.008}, {"friction": 0.03}),
    "muscle_creep": ({"share": 0.2, "time": 0.6}, {"share": 0.6}),
    "muscle_viscosity": ({"contracting": 30.0, "lengthening": 15.0}, {"contracting": 100.0, "lengthening": 50.0}),
    "stroke_softening": ({"loss": 0.1, "trials": 2.0}, {"loss": 0.3}),
    "odd_muscle": ({"channel": 1, "factor": 0.85}, {"factor": 0.6}),
    "filling_lag": ({"fill": 0.05, "empty": 0.08}, {"fill": 0.15, "empty": 0.25}),
    "dead_time": ({"delay": 0.03}, {"delay": 0.1}),
    "supply_droop": ({"share": 0.05}, {"share": 0.15}),
    "line_loss": ({"share": 0.2}, {"share": 0.6}),
    "orthotropy": ({"ratio": 0.7}, {"ratio": 0.4}),
    "local_stiffening": ({"radius": 0.04, "factor": 3.0}, {"factor": 10.0}),
    "stress_relaxation": ({"share": 0.2, "time": 0.6}, {"share": 0.5}),
    "rest_curvature": ({"down": 0.8}, {"down": 2.5}),
    "loop_slip": ({"friction": 0.02, "grip": 0.02}, {"friction": 0.08, "grip": 0.08}),
    "air_drag": ({"coefficient": 10.0}, {"coefficient": 40.0}),
    "frame_tilt": ({"about_x": 1.0}, {"about_x": 3.0}),
    "added_mass": ({"mass": 0.003}, {"mass": 0.010}),
    "registration_bias": ({"z": 0.002}, {"z": 0.006}),
    "time_offset": ({"offset": 0.03}, {"offset": 0.08}),
    "scale_error": ({"scale": 0.01}, {"scale": 0.03}),
    "lag_of_two_volumes": ({"line": 0.04, "muscle": 0.04}, {"line": 0.1, "muscle": 0.1}),
    "creep_of_two_times": ({"share": 0.3, "quick": 0.2, "slow": 1.0}, {"share": 1.0}),
    "orthotropy_of_bending": ({"ratio": 2.0}, {"ratio": 4.0}),
    "droop_by_flow": ({"share": 0.15}, {"share": 0.35}),
    "wind": ({"z": 0.2}, {"z": 0.5}),
    "spring": ({"stiffness": 0.2}, {"stiffness": 0.5}),
    "seam_snap": ({"factor": 4.0}, {"factor": 10.0}),
    "heating": ({"loss": 0.2}, {"loss": 0.5}),
    "crosstalk": ({"share": 0.1}, {"share": 0.25}),
}  # fmt: skip
UNLISTED = "wind", "spring", "seam_snap", "heating", "crosstalk"
# over the session, outside the list; the cloth moves by some 3 to 5 mm from the first trial to the last fitted
DRIFTS: tuple[tuple[str, dict[str, float]], ...] = (
    ("sinking_supply", {"full": 350.0, "sink": 20.0}),
    ("heating", {"loss": 0.8, "time": 3.0, "each_trial": 0.8}),
    ("loosening", {"channel": 1, "give": 0.2, "trials": 2.0}),
    ("loosening", {"channel": 0, "give": 1.0, "trials": 2.0}),
    ("heating", {"loss": 0.5, "time": 3.0, "each_trial": 0.8}),
    ("sinking_supply", {"full": 350.0, "sink": 60.0}),
    ("heating", {"loss": 0.3, "time": 3.0, "each_trial": 0.8}),
    ("loosening", {"channel": 2, "give": 1.0, "trials": 2.0}),
)
WITHHELD = (
    "filling_lag", "orthotropy", "muscle_creep", "line_loss", "supply_droop", "braid_hysteresis", "frame_tilt",
    "rest_curvature", "odd_muscle", "dead_time",
)  # fmt: skip
TOGETHER = (
    ("filling_lag", "orthotropy"), ("dead_time", "rest_curvature"), ("odd_muscle", "frame_tilt"),
    ("muscle_creep", "line_loss"), ("braid_hysteresis", "supply_droop"), ("stress_relaxation", "filling_lag"),
    ("orthotropy", "added_mass", "filling_lag"), ("rest_curvature", "supply_droop", "dead_time"),
    ("frame_tilt", "muscle_viscosity", "line_loss"), ("filling_lag", "orthotropy", "air_drag"),
    ("filling_lag", "line_loss", "frame_tilt", "muscle_creep"),
    ("rest_curvature", "orthotropy", "supply_droop", "braid_hysteresis"),
)  # fmt: skip
# on programs that hold: names, and whether of the larger size
HELD: tuple[tuple[tuple[str, ...], bool], ...] = (
    (("orthotropy",), True), (("filling_lag",), True), (("rest_curvature",), True), (("odd_muscle",), True),
    ((), True), (("filling_lag", "orthotropy"), True), (("muscle_creep",), True), (("frame_tilt",), False),
    (("line_loss",), True), (("rest_curvature", "supply_droop"), True), (("orthotropy",), False), (("wind",), True),
    (("supply_droop",), True), ((), True), (("odd_muscle", "frame_tilt"), True), (("dead_time",), True),
    (("muscle_creep", "line_loss"), True), (("braid_hysteresis",), True), ((), True), (("rest_curvature",), False),
    (("crosstalk",), True), (("threshold_pressure",), True), (("orthotropy", "rest_curvature", "odd_muscle"), True),
    ((), True),
)  # fmt: skip


def _sized(effects: Sequence[str], large: bool) -> dict[str, dict[str, float]]:
    return {effect: values | more if large else values for effect in effects for values, more in [SIZES[effect]]}


def _rigs() -> Iterator[Rig]:
    """The larger of each pair first, which half of the layouts see; seeds that nothing was tuned on."""
    listed = [name for name in SIZES if name not in UNLISTED]
    for large in (True, False):
        for k, name in enumerate(listed):
            yield Rig("one", f"{name}_{2 if large else 1}", LAYOUTS[k % 4], 9200 + 2 * k + large, _sized([name], large))
    for k in range(NULLS):
        yield Rig("none", f"none_{k}", LAYOUTS[k % 4], 9012 + k)
    for k, names in enumerate(TOGETHER):
        yield Rig("several", f"several_{k}", LAYOUTS[k % 4], 9300 + k, _sized(names, large=True))
    for k, name in enumerate(UNLISTED):
        for large in (True, False):
            seed = 9400 + 2 * k + large
            yield Rig("outside", f"{name}_{2 if large else 1}", LAYOUTS[k % 4], seed, _sized([name], large))
    for k, name in enumerate(WITHHELD):
        yield Rig("withheld", f"without_{name}", LAYOUTS[k % 4], 9500 + k, _sized([name], large=True))
    for k, (name, drift) in enumerate(DRIFTS):
        yield Rig("drift", f"drift_{k}", LAYOUTS[k % 4], 9600 + k, {name: drift})
    for k, (names, large) in enumerate(HELD):
        yield Rig("held", f"held_{k}", LAYOUTS[k % 4], 9700 + k, _sized(names, large))


RIGS = tuple(_rigs())
QUICK = "filling_lag_2", "frame_tilt_2", "orthotropy_2", "none_0", "none_1", "none_2"


def make(rig: Rig, folder: Path, *, workers: int | None = None) -> None:
    """Measure its six programs on the virtual rig, into `folder`, the last of role test."""
    rng = np.random.default_rng([rig.seed, 1])
    made = held_programs if rig.kind == "held" else programs
    measure(rig, made(rig.design.channels, rng), folder, test_trials=1, workers=workers)


def drift(rig: Rig) -> Array:
    """Return (programs fitted,) m RMS over the cloth and time by which a rig's effects move each of its programs from
    the first place of the session to the last that is fitted, on a coarse mesh."""
    *fitted, _ = programs(rig.design.channels, np.random.default_rng([rig.seed, 1]))
    coarse = Resolution(element=0.04, step=1 / 240)
    times = np.arange(1, 46) / 30
    uv = np.stack(np.meshgrid(*2 * [np.linspace(0, 0.2, 9)]), axis=-1).reshape(-1, 2)
    squares = []
    for program in fitted:
        first, last = (
            TrialTask(rig.design, program, times, order, rig.truth, coarse) for order in (0, len(fitted) - 1)
        )
        moved = control_points(last) - control_points(first)
        on_cloth = prepare(first).patch.matrix(uv)
        squares.append(np.mean([np.square(on_cloth @ x).sum(axis=1) for x in moved]))
    return np.sqrt(squares)


def measure(
    rig: Rig,
    pressure_programs: list[PressureProgram],
    folder: Path,
    *,
    test_trials: int = 0,
    workers: int | None = None,
) -> None:
    """Measure pressure programs on the virtual rig, into `folder`."""
    run_rig(RigSession([(rig.design, pressure_programs)], rig.truth, test_trials), folder, workers=workers, force=True)


def programs(channels: int, rng: np.random.Generator) -> list[PressureProgram]:
    """Six: what a laboratory would run."""
    some = [rng.uniform(0.3, 1.0, channels) * HIGHEST for _ in range(3)]
    stairs = np.array([1, 2, 3, 2, 1]) / 3
    ramp = 1 - np.abs(np.linspace(-1, 1, 30))
    turn = np.arange(channels) * SECONDS / channels
    return [
        _rows([0.0, 0.7], [some[0], 0 * some[0]]),
        _rows(np.arange(5) * 0.3, stairs[:, None] * some[1]),
        _rows(np.arange(30) * 0.05, ramp[:, None] * some[2]),
        _rows(turn, np.diag(np.full(channels, 300e3))),
        *(_rows(np.arange(3) * 0.5, rng.uniform(0, HIGHEST, (3, channels))) for _ in range(2)),
    ]


def held_programs(channels: int, rng: np.random.Generator) -> list[PressureProgram]:
    """Six in which the cloth comes to rest at each level."""
    some = [rng.uniform(0.3, 1.0, channels) * HIGHEST for _ in range(2)]
    turn = np.arange(channels) * 2 * SECONDS / channels
    stairs = np.array([1, 2, 3, 1.5]) / 3
    rows = [
        ([0.0, SECONDS], [some[0], 0 * some[0]]),
        (np.arange(4) * SECONDS / 2, stairs[:, None] * some[1]),
        (turn, np.diag(np.full(channels, 300e3))),
        *((np.arange(3.0), rng.uniform(0, HIGHEST, (3, channels))) for _ in range(3)),
    ]
    return [_rows(times, pressures, 2 * SECONDS) for times, pressures in rows]


def _rows(times: Any, pressures: Any, seconds: float = SECONDS) -> PressureProgram:
    return PressureProgram(np.asarray(times, dtype=float), np.asarray(pressures, dtype=float), seconds)
