"""A model as it is used: read, told where it is stale, and without the parts that are left out."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from fabdesign.model import PARTS, Model
from fabdesign.model_file import read_model
from fabdesign.table import nearest


def usable_model(
    model: Model | Path | str, without: Sequence[str] = (), *, say: Callable[[str], None] = lambda line: None
) -> Model:
    """The model, or that of a file, less the parts named (fabdesign.model.PARTS).

    `say` hears a line where it was made by another version of the simulator, and on what was left out. Raises
    InputError.
    """
    name = "model" if isinstance(model, Model) else str(model)
    read = model if isinstance(model, Model) else read_model(model)
    if read.stale is not None:
        say(f"{name}: {read.stale}")
    if not without:
        return read
    parts: list[Any] = [part.strip() for part in without]
    for part in parts:
        if part not in PARTS:
            raise InputError(f"--without {part}: expected one of {', '.join(PARTS)}{nearest(part, PARTS)}")
    less = read.without(parts)
    gone = [*(e.name for e in read.effects if e not in less.effects)]
    gone += [parameter for parameter in read.parameters if parameter not in less.parameters]
    gone += ["corrector"] if read.corrector is not None and less.corrector is None else []
    say(f"{name}: without {', '.join(parts)}: {', '.join(gone) or 'nothing'} left out")
    return less
