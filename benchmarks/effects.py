"""What each effect looks like and what it costs: draws docs/lab/effects.png and prints the table of costs.

    python -m benchmarks.effects [-o docs/lab/effects.png]

Costs are processor seconds of 16 motions of 0.5 s at 41 points a side, the least of three rounds in turn.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects import BUILT_IN, EFFECTS
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case, Term
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram
from sim import Simulator

DESIGN = build("side", muscles=4)
TIMES = np.arange(91) / 60  # s
PULSE = PressureProgram(np.array([0.0, 0.75]), 1e3 * np.array([[200.0, 150, 100, 0], [0.0, 0, 0, 0]]), 1.5)
RAMP = PressureProgram(
    np.arange(61) / 40, 1e3 * np.outer(np.r_[np.arange(30), np.arange(30, -1, -1)] / 30, (200, 150, 100, 0)), 1.5
)
IDLE = PressureProgram(np.zeros(1), np.zeros((1, 4)), 1.5)
SHOWN = {
    "air_drag": {"coefficient": 30.0},
    "odd_muscle": {"factor": 0.5},
    "muscle_creep": {"share": 0.4, "time": 0.4},
    "orthotropy": {"ratio": 3.0},
}
PROFILES = {
    "odd_muscle": "u", "line_loss": "u", "orthotropy": "v", "rest_curvature": "v", "frame_tilt": "v",
}  # along which, at hold  # fmt: skip
ORDER = 3  # in the session
AT_REST = "rest_curvature", "frame_tilt"  # what shows without pressure


def signatures(output: Path) -> None:
    """A panel an effect: without it grey, with it red."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(4, 5, figsize=(11, 7.2), layout="constrained")
    forward = Predictor(Simulator(21), Model(), sensing=True)
    for panel, name in zip(panels.flat, BUILT_IN, strict=False):
        program = RAMP if name == "braid_hysteresis" else IDLE if name in AT_REST else PULSE
        shown = Term(name, SHOWN.get(name, {}))
        cases = [Case(DESIGN, program), Case(DESIGN, program, effects=(shown,), order=ORDER)]
        motions = forward.motions(cases, [TIMES] * 2)
        for points, colour in zip(motions, ("0.6", "C3"), strict=True):
            x, y, label = _curve(name, points.astype(float).reshape(-1, 2, 41, 41, 3).mean(axis=1), program)
            panel.plot(x, y, color=colour, linewidth=1.2)
            panel.set_xlabel(label, fontsize=7)
        panel.set_title(name, fontsize=8)
        panel.tick_params(labelsize=6)
    for panel in panels.flat[len(BUILT_IN) :]:
        panel.axis("off")
    figure.supylabel("z [mm]", fontsize=8)
    figure.savefig(output, dpi=90)


def _curve(name: str, middle: NDArray[np.float64], program: PressureProgram) -> tuple[Any, Any, str]:
    """Of (T, 41, 41, 3) m: abscissa, z [mm], what the abscissa is."""
    z, along = 1e3 * middle[..., 2], np.linspace(0, 200, 41)
    if name in PROFILES:
        hold = z[44]
        return (along, hold[-1], "u along the hem [mm], at hold") if PROFILES[name] == "u" else (
            along, hold[:, 20], "v down the middle [mm]" + (", at rest" if name in AT_REST else ", at hold"),
        )  # fmt: skip
    hem = z[:, -1, 20]
    if name == "braid_hysteresis":
        return program.at(TIMES - 1 / 120)[:, 0] / 1e3, hem, "pressure [kPa]"
    return TIMES, hem, "time [s], middle of the hem"


def costs(names: Sequence[str]) -> dict[str, float]:
    """Processor seconds of 16 motions with each effect, `none`, and `all`."""
    times, simulator = np.arange(1, 31) / 60, Simulator()
    terms = {"none": ()} | {name: (Term(name),) for name in names} | {"all": tuple(Term(name) for name in names)}
    spent: dict[str, list[float]] = {name: [] for name in terms}
    for k in range(4):
        for name, effects in terms.items():
            cases = [Case(DESIGN, PULSE, {"bending": 1 + 0.01 * i}, effects) for i in range(16)]
            begin = time.process_time()
            simulator.run(cases, [times] * len(cases))
            if k:  # the first compiles
                spent[name].append(time.process_time() - begin)
    return {name: min(seconds) for name, seconds in spent.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/lab/effects.png"))
    signatures(parser.parse_args().output)
    cpu_seconds = costs([name for name in BUILT_IN if EFFECTS[name].site != "sensing"])
    for name, seconds in cpu_seconds.items():
        print(f"| `{name}` | {seconds:.2f} | {seconds / cpu_seconds['none']:.2f} |")


if __name__ == "__main__":
    main()
