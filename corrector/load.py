"""From a model to its corrector."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corrector.basis import names
from corrector.field import FieldCorrector
from corrector.weights_file import read_weights
from fabdesign.corrector import Corrector
from fabdesign.errors import InputError
from fabdesign.model import Model
from fabdesign.trained_on import central_hash


def load_corrector(model: Model) -> Corrector:
    """The corrector that a model names. Raises InputError for a file that is none, and for a model whose parameters or
    effects are no longer those that it was trained on."""
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
