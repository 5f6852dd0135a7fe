"""Fabric actuators: cloth with laced McKibben muscles, designed, simulated, measured and improved.

Inside, everything is SI; pressures of these functions, of files and of the command line are in kPa. Arguments are
objects or paths. Everything here is loaded when it is asked for, so that this import costs nothing.

    >>> import fabdesign
    >>> cloth = fabdesign.build("vertical", muscles=2)
    >>> shape = fabdesign.equilibrium(cloth, [300, 300], grid=21)  # kPa
    >>> shape.faces.shape  # frame, face, row, column, x y z in m
    (1, 2, 41, 41, 3)

Nouns: Design, Fabric, Muscle, MuscleType, Model; `build` makes a catalogue layout; `read_design`, `read_set` and
`read_model` read files. Verbs: `simulate` `equilibrium` `sweep` `sensitivity` `optimize` `follow` `layouts` `unseen`
`loop` `study` `calibrate` `train` `predict` `evaluate` `trace` `fuse` `rig` `new` `check` `export` `view` `studio`
`demo` `prepare`, and `studies`. Each is the command of its name. What they raise: InputError, SimulationError.
"""

# ruff: noqa: F403, F405 the verbs are named once, in `interface`
TYPE_CHECKING = False  # of `typing`, which would take longer to load than all of this
if TYPE_CHECKING:
    from typing import Any

    from fabdesign.errors import InputError, SimulationError
    from fabdesign.files.design_file import read_design
    from fabdesign.files.measurement_set import read_set
    from fabdesign.files.model_file import read_model
    from fabdesign.interface import *
    from fabdesign.nouns.catalogue import build
    from fabdesign.nouns.design import Design
    from fabdesign.nouns.fabric import Fabric
    from fabdesign.nouns.model import Model
    from fabdesign.nouns.muscle import Muscle, MuscleType
    from fabdesign.version import __version__ as __version__

__all__ = [
    "Design", "Fabric", "InputError", "Model", "Muscle", "MuscleType", "SimulationError", "build", "calibrate",
    "check", "demo", "equilibrium", "evaluate", "export", "follow", "fuse", "layouts", "loop", "new", "optimize",
    "predict", "prepare", "read_design", "read_model", "read_set", "rig", "schema", "sensitivity", "simulate",
    "studies", "studio", "study", "sweep", "trace", "train", "unseen", "view",
]  # fmt: skip
_WHERE = {
    "Design": "nouns.design", "Fabric": "nouns.fabric", "InputError": "errors", "Model": "nouns.model",
    "Muscle": "nouns.muscle", "MuscleType": "nouns.muscle", "SimulationError": "errors", "build": "nouns.catalogue",
    "read_design": "files.design_file", "read_model": "files.model_file", "read_set": "files.measurement_set",
    "__version__": "version",
}  # fmt: skip


def one_blas_thread() -> None:
    """Have NumPy's matrices take one thread, unless NumPy is loaded or the environment says otherwise: they are small
    here, and on a busy machine threads that wait for each other cost ten times them."""
    import os
    import sys

    if "numpy" not in sys.modules:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def __getattr__(name: str) -> "Any":
    if name not in {*__all__, *_WHERE}:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    one_blas_thread()
    return getattr(import_module(f"fabdesign.{_WHERE.get(name, 'interface')}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
