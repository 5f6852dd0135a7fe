"""A corrector's file: safetensors, its metadata says of which kind and size it is and what it was trained on."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from fabdesign.errors import InputError
from fabdesign.output import whole_file

FORMAT = "fabdesign.corrector/1"
_KEY = "fabdesign"

Weights = Mapping[str, NDArray[np.float32]]


def write_weights(path: Path, weights: Weights, about: Mapping[str, Any]) -> None:
    """Write arrays by name and what is to be known about them (JSON), whole."""
    content = json.dumps({"format": FORMAT} | dict(about), allow_nan=False)
    with whole_file(path) as temporary:
        temporary.write_bytes(save({k: np.ascontiguousarray(v) for k, v in weights.items()}, {_KEY: content}))


def read_weights(path: Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, Any]]:
    """The arrays and what is known about them. Raises InputError for a file that is not there or not a corrector's."""
    try:
        with safe_open(path, framework="numpy") as stream:
            about = json.loads((stream.metadata() or {}).get(_KEY, "{}"))
            weights = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118 it is no dict
    except (OSError, SafetensorError, ValueError) as error:
        raise InputError(f"{path}: no weights of a corrector can be read ({error})") from None
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        found = about.get("format") if isinstance(about, dict) else None
        raise InputError(f"{path}: format {found}; expected {FORMAT}")
    for name, array in weights.items():
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name} holds values that are not finite")
    return weights, about
