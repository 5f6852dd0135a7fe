"""The motion that is played, as a file for other programs: what `fabdesign view -o` writes, by the file's ending."""

from pathlib import Path

import numpy as np

from fabdesign.errors import InputError
from fabdesign.motion_file import MotionData
from fabdesign.output import new_files
from studies.studio.measured import TrialMotion
from studies.view.items import Item
from studies.view.write import KINDS, writer

SLOW = ".gif"  # for which the page would stand still; `view` writes it


def require_kind(path: Path) -> str:
    """The file's ending. Raises InputError."""
    kind, kinds = path.suffix.lower(), [kind for kind in KINDS if kind != SLOW]
    if kind not in kinds:
        raise InputError(f"{path}: expected a name that ends in {', '.join(kinds[:-1])} or {kinds[-1]}")
    return kind


def export_motion(path: Path, shown: TrialMotion, laced: MotionData) -> None:
    """laced: the motion that is shown, with its muscles. What was measured stands beside it, but not in a table of
    markers, which it has not. Raises InputError, also for a file that is there."""
    kind = require_kind(path)
    items = [Item.of_motion(shown.name, laced)]
    if shown.trial is not None and kind != ".csv":
        measured = Item(f"{shown.name}, measured", np.asarray(shown.times, np.float64), shown.trial.frames)
        items = [measured, Item.of_motion(f"{shown.name}, predicted", laced, measured.title)]
    try:
        with new_files(path) as unfinished:
            writer(kind)(items, unfinished)
    except ModuleNotFoundError as error:
        raise InputError(f"{path}: needs {error.name}; install it with: pip install 'fabdesign[view]'") from None
