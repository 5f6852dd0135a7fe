"""What a user does, in Python: `import fabdesign`, then `fabdesign.simulate`, `optimize`, `calibrate` and so on.

Each does what the command of that name does, for the command calls it or what it calls. Arguments are objects or
paths. Pressures are typed in kPa; all else is SI, points in metres. Where a function takes `progress`, it is called
with a line and the share of the work that is done (None where that is not known); `say` hears what a person should
know, by default as a warning; `cluster` is the address of a Dask scheduler whose workers compute (docs/cluster.md).

The only package of `fabdesign` that knows the others (sim, studies); loaded when it is asked for.
"""

from fabdesign.interface.fits import calibrate, trace, train
from fabdesign.interface.measured import evaluate, predict
from fabdesign.interface.motions import equilibrium, simulate, sweep
from fabdesign.interface.results import Calibrated, Evaluated, Motion, Sweep, Traced, Trained
from fabdesign.interface.searches import layouts, optimize, sensitivity
from fabdesign.interface.study_results import Layouts, Optimized, Sensitivity, Unseen
from fabdesign.interface.unsewn import unseen

__all__ = [
    "Calibrated", "Evaluated", "Layouts", "Motion", "Optimized", "Sensitivity", "Sweep", "Traced", "Trained", "Unseen",
    "calibrate", "equilibrium", "evaluate", "layouts", "optimize", "predict", "sensitivity", "simulate", "sweep",
    "trace", "train", "unseen",
]  # fmt: skip
