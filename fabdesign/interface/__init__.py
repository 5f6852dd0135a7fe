"""The actions of a user, in Python: `import fabdesign`, then `fabdesign.simulate`, `optimize`, `calibrate` and so on.

Each function is the command of its name, which is built from it (`verb.py`): the same arguments, defaults, checks and
figures. What is measured, or asked of, comes first, then the model, then `out`. Arguments are objects or paths.
Pressures are typed in kPa; all else is SI, points in metres. Shared by many: `force` replaces output that exists;
`progress` is called with a line and the share of the work that is done (None where that is not known); `say` hears what
a person should know, by default as a warning; `effects` are files of own effects; `cluster` is the address of a Dask
scheduler whose workers compute (docs/cluster.md); `seed` is of what is drawn; `grid` is points a side; `without` names
parts of the model to leave out; `skip_bad` leaves out unsound trials.

The only package of `fabdesign` that knows the others (sim, studies); loaded when it is asked for, without numpy.
"""

from fabdesign import one_blas_thread
from fabdesign.interface import folders as studies
from fabdesign.interface.analyses import loop, sensitivity, study, unseen
from fabdesign.interface.files import check, export, new, studio, view
from fabdesign.interface.fits import calibrate, train
from fabdesign.interface.folders import list_effects, prepare, schema
from fabdesign.interface.laboratory import fuse, rig
from fabdesign.interface.measured import evaluate, predict, trace
from fabdesign.interface.motions import equilibrium, simulate, sweep
from fabdesign.interface.searches import demo, follow, layouts, optimize

one_blas_thread()  # for the commands; in Python it was asked for already
__all__ = [
    "calibrate", "check", "demo", "equilibrium", "evaluate", "export", "follow", "fuse", "layouts", "list_effects",
    "loop", "new", "optimize", "predict", "prepare", "rig", "schema", "sensitivity", "simulate", "studies", "studio",
    "study", "sweep", "trace", "train", "unseen", "view",
]  # fmt: skip
