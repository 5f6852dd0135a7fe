"""The synthetic rig's sets on which traces are judged: one effect each, or none; and some with several.

Rigs of a catalogue layout, their factors drawn from calibration's prior; six trials of 1.5 s at 30 Hz (a step on and
off, a staircase, a ramp, channels in turn, random levels twice), the last of role test. Effects that are none of the
simulator's list are right where they are called unexplained; those of another form (docs/rig.md) where the listed
effect is named.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.catalogue import build
from fabdesign.design import Design
from fabdesign.forward import PARAMETERS
from fabdesign.pressure import PressureProgram
from optimize.fit.parameters import PRIOR
from studies.rig import EffectSetting, run_rig
from studies.rig.effects.variants import OF
from studies.rig.ground_truth import GroundTruth

SECONDS = 1.5
HIGHEST = 350e3  # Pa
UNLISTED = ("wind", "spring")
NULLS = 24  # sets without an effect


@dataclass(frozen=True)
class Rig:
    """A specimen. layout: name and number of muscles. effects: by name, their values."""

    name: str
    layout: tuple[str, int]
    seed: int
    effects: dict[str, dict[str, float]] = field(default_factory=dict)

    @property
    def right(self) -> str:
        """The verdict, or the effects' names."""
        if not self.effects:
            return "adequate"
        return "unexplained" if set(UNLISTED) & set(self.effects) else " + ".join(OF.get(e, e) for e in self.effects)

    @property
    def design(self) -> Design:
        return build(self.layout[0], muscles=self.layout[1])

    @property
    def factors(self) -> dict[str, float]:
        rng = np.random.default_rng(self.seed)
        return {name: float(np.exp(PRIOR[name] * np.clip(rng.standard_normal(), -2, 2))) for name in PARAMETERS}

    @property
    def put_in(self) -> str:
        """For people."""
        told = [f"{e} ({', '.join(f'{name} {x:g}' for name, x in v.items())})" for e, v in self.effects.items()]
        return ", ".join(told) or "nothing"


VERTICAL, SIDE, CROSS, BASIC = ("vertical", 3), ("side", 4), ("cross", 2), ("basic", 4)
RIGS = (
    Rig("hysteresis", VERTICAL, 9000, {"braid_hysteresis": {"friction": 0.03, "slip": 0.008}}),
    Rig("creep", CROSS, 9001, {"creep_of_two_times": {"share": 1.0, "quick": 0.2, "slow": 1.0}}),
    Rig("odd", VERTICAL, 9002, {"odd_muscle": {"channel": 1, "factor": 0.45}}),
    Rig("lag", CROSS, 9003, {"lag_of_two_volumes": {"line": 0.1, "muscle": 0.1}}),
    Rig("dead", BASIC, 9004, {"dead_time": {"delay": 0.1}}),
    Rig("droop", VERTICAL, 9005, {"droop_by_flow": {"share": 0.35}}),
    Rig("loss", CROSS, 9006, {"line_loss": {"share": 0.7}}),
    Rig("orthotropy", CROSS, 9007, {"orthotropy_of_bending": {"ratio": 3.0}}),
    Rig("drag", CROSS, 9008, {"air_drag": {"coefficient": 60.0}}),
    Rig("tilt", SIDE, 9009, {"frame_tilt": {"about_x": 2.5}}),
    Rig("wind", BASIC, 9010, {"wind": {"z": 0.5}}),
    Rig("spring", VERTICAL, 9011, {"spring": {"stiffness": 0.4}}),
    *(Rig(f"none_{k}", (VERTICAL, SIDE, CROSS, BASIC)[k % 4], 9012 + k) for k in range(NULLS)),
)
# blind too: each effect by itself explains too little of what they do together
SEVERAL = (
    Rig(
        "three_basic", BASIC, 9100,
        {"filling_lag": {"fill": 0.08, "empty": 0.12}, "orthotropy": {"ratio": 0.6}, "air_drag": {"coefficient": 20.0}},
    ),
    Rig(
        "three_vertical", VERTICAL, 9101,
        {"dead_time": {"delay": 0.05}, "supply_droop": {"share": 0.1}, "rest_curvature": {"down": 1.2}},
    ),
    Rig(
        "four_side", SIDE, 9102,
        {"filling_lag": {"fill": 0.1, "empty": 0.1}, "line_loss": {"share": 0.3}, "frame_tilt": {"about_x": 1.0},
         "muscle_creep": {"share": 0.2, "time": 0.8}},
    ),
)  # fmt: skip


def make(rig: Rig, folder: Path, *, workers: int | None = None) -> None:
    """Measure its six programs on the virtual rig, into `folder`, the last of role test."""
    rng = np.random.default_rng([rig.seed, 1])
    measure(rig, programs(rig.design.channels, rng), folder, test_trials=1, workers=workers)


def measure(
    rig: Rig, told: list[PressureProgram], folder: Path, *, test_trials: int = 0, workers: int | None = None
) -> None:
    """Measure pressure programs on the virtual rig, into `folder`."""
    effects = tuple(EffectSetting(name, values) for name, values in rig.effects.items())
    truth = GroundTruth(rig.seed, rig.factors, effects)
    run_rig(rig.design, told, out=folder, truth=truth, test_trials=test_trials, workers=workers, force=True)


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


def _rows(times: Any, pressures: Any) -> PressureProgram:
    return PressureProgram(np.asarray(times, dtype=float), np.asarray(pressures, dtype=float), SECONDS)
