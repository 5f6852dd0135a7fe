"""Model files: `fabdesign.model/1`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import tomlkit

from fabdesign.errors import InputError
from fabdesign.formats.codec import Encoder, decode
from fabdesign.formats.table import load_toml, nearest
from fabdesign.nouns.model import PARTS, Model
from fabdesign.nouns.model_sampling import spread_of
from fabdesign.output import write_text

FORMAT = "fabdesign.model/1"


def read_model(path: Path | str) -> Model:
    """Read a model: its file, or a folder with `model.toml`. Raises InputError."""
    path = Path(path)
    if path.is_dir():
        path = path / "model.toml"
    model = decode(Model, load_toml(path, FORMAT))
    if model.corrector_hash not in (None, model.central_hash):
        raise InputError(
            f"{path}: corrector: trained on other parameters or effects than the file has now; expected those it was "
            "trained on (train again, or take [corrector] out)"
        )
    return model


def write_model(model: Model, path: Path | str) -> None:
    """Write a model; reading it gives an equal one. The corrector's weights must lie there already; their path is
    stored relative to the file. Raises InputError where `path` cannot be written."""
    path = Path(path)
    write_text(path, tomlkit.dumps({"format": FORMAT} | Encoder(path).encode(model)))


def usable_model(
    model: Model | Path | str, without: Sequence[str] = (), *, say: Callable[[str], None] = lambda line: None
) -> Model:
    """Return the model, or that of a file, less the parts named (fabdesign.nouns.model.PARTS).

    `say` hears a line where it was made by another version of the simulator, and on what was left out. Raises
    InputError.
    """
    name = "model" if isinstance(model, Model) else str(model)
    read = model if isinstance(model, Model) else read_model(model)
    if read.stale is not None:
        say(f"{name}: {read.stale}")
    if read.spread is not None and spread_of(read) is None:
        say(f"{name}: the model was changed since its intervals were calibrated; its motions have none")
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
    gone += ["spread"] if read.spread is not None and less.spread is None else []
    say(f"{name}: without {', '.join(parts)}: {', '.join(gone) or 'nothing'} left out")
    return less
