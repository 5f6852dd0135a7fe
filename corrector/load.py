"""The corrector of a model, loaded from its file."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from corrector.basis import names
from corrector.field import FieldCorrector
from fabdesign.errors import InputError
from fabdesign.nouns.corrector import Corrector, central_hash
from fabdesign.nouns.model import Model
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
    """Return the arrays and what is known about them. Raises InputError for a file that is not there or not a
    corrector's."""
    try:
        with safe_open(path, framework="numpy") as stream:
            about = json.loads((stream.metadata() or {}).get(_KEY, "{}"))
            weights = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118 it is no dict
    except (OSError, SafetensorError, ValueError) as error:
        raise InputError(f"{path}: no weights of a corrector can be read ({error})") from None
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        given = about.get("format") if isinstance(about, dict) else None
        raise InputError(f"{path}: format {given}; expected {FORMAT}")
    for name, array in weights.items():
        if not np.isfinite(array).all():
            raise InputError(f"{path}: {name} holds values that are not finite")
    return weights, about


def load_corrector(model: Model) -> Corrector:
    """Return the corrector that a model names. Raises InputError for a file that is none, and for a model whose
    parameters or effects are no longer those that it was trained on."""
    path = model.corrector
    if path is None:
        raise ValueError("the model names no corrector")
    weights, about = read_weights(path)
    if about.get("trained_on") != central_hash(model):
        raise InputError(
            f"{path}: trained on other parameters or effects than the model has; expected those it was trained on "
            "(train again, or take [corrector] out of the model)"
        )
    try:
        if about["network"] == "field":
            return _field(weights, about)
        if about["network"] == "paper":
            from corrector.paper import PaperCorrector  # here: it loads PyTorch

            return PaperCorrector.of(weights, about)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: not weights that this version reads ({type(error).__name__}: {error})") from None
    raise InputError(f"{path}: network {about['network']}; expected field or paper")


def _field(weights: dict[str, NDArray[np.float32]], about: Mapping[str, Any]) -> FieldCorrector:
    if list(about["sources"]) != list(names()):
        raise ValueError("other basis functions than this version has; train again")
    seen, unseen = (weights[name].astype(np.float64) for name in ("seen", "unseen"))
    return FieldCorrector(seen, unseen, list(about["known"]), float(about["trust_limit"]))
