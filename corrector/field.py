"""The field corrector, a displacement of the ordered points, in numpy; and the corrector of a model, loaded from its
file."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from corrector.basis import Basis, names
from corrector.inputs import HISTORY, MuscleFields, fields_of
from corrector.layout import described, distance
from corrector.outputs import displacement_of, weight_over_stiffness
from corrector.shape import FINE, LocalFrames, displaced
from fabdesign.errors import InputError
from fabdesign.geometry.shape import Shape
from fabdesign.nouns.array import Floats
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, Corrector, Trust, with_history
from fabdesign.nouns.model import Model
from fabdesign.output import atomic_file

FAMILIAR = 0.2  # distance over which a design stops being one of those learned from


@dataclass(frozen=True, eq=False)
class FieldCorrector:
    """Implements fabdesign.nouns.forward.Corrector. `known`: the designs it learned from (`designs.described`)."""

    seen: NDArray[np.float64]  # (K,) coefficients of the basis functions, for layouts learned from
    unseen: NDArray[np.float64]  # (K,) for others
    known: Sequence[Mapping[str, Any]]
    limit: float  # of trust
    ordered: bool = True
    starts: float = 0.0
    _layouts: dict[int, tuple[Design, MuscleFields, Trust]] = field(
        default_factory=dict
    )  # by the design's id, which it keeps

    def history(self) -> tuple[float, ...]:
        return HISTORY

    def trust(self, design: Design) -> Trust:
        return Trust(distance(described(design), self.known), self.limit)

    def correct(
        self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]], motions: Sequence[Floats]
    ) -> list[NDArray[np.float32]]:
        """See fabdesign.nouns.forward.Corrector."""
        return [self._correct(*one) for one in zip(cases, times, motions, strict=True)]

    def _correct(self, case: Case, times: NDArray[np.float64], motion: Floats) -> NDArray[np.float32]:
        _, where = with_history(times, HISTORY)
        _, trust = self._known(case.design)
        answer = np.array(motion[where[0]], dtype=np.float32)
        sound = np.isfinite(motion[where]).all(axis=(0, 2, 3))
        if trust.applies and sound.any():
            moved = self.displacement(case, times[sound], motion[where[:, sound]])
            answer[sound] = displaced(answer[sound], moved, case.design.fabric.thickness)
        return answer

    def displacement(self, case: Case, times: NDArray[np.float64], motion: Floats) -> NDArray[np.float32]:
        """Return (T, FINE, FINE, 3) m of the mid-surface. motion: as `inputs.fields_of` takes it."""
        fabric = case.design.fabric
        layout, trust = self._known(case.design)
        combination = Basis.of(fields_of(case, layout, times, motion)).combined(self.coefficients(trust.distance))
        middle = Shape(motion[0]).middle.astype(np.float32)
        frames = LocalFrames.of(middle, fabric.width, fabric.height, FINE)
        return displacement_of(combination, frames, fabric, weight_over_stiffness(case))

    def coefficients(self, distance: float) -> NDArray[np.float64]:
        """Return (K,) for a design so far from those learned from."""
        nearness = max(1 - distance / FAMILIAR, 0.0)
        return nearness * self.seen + (1 - nearness) * self.unseen

    def _known(self, design: Design) -> tuple[MuscleFields, Trust]:
        """Return what is the same in all motions of a design, worked out once."""
        if id(design) not in self._layouts:
            if len(self._layouts) > 64:  # a search asks for thousands of designs
                self._layouts.clear()
            self._layouts[id(design)] = (design, MuscleFields.of(design), self.trust(design))
        _, layout, trust = self._layouts[id(design)]
        return layout, trust


FORMAT = "fabdesign.corrector/1"
_KEY = "fabdesign"

Weights = Mapping[str, NDArray[np.float32]]


def write_weights(path: Path, weights: Weights, about: Mapping[str, Any]) -> None:
    """Write arrays by name and what is to be known about them (JSON), whole."""
    content = json.dumps({"format": FORMAT} | dict(about), allow_nan=False)
    with atomic_file(path) as temporary:
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
    if about.get("trained_on") != model.central_hash:
        raise InputError(
            f"{path}: trained on other parameters or effects than the model has; expected those it was trained on "
            "(train again, or take [corrector] out of the model)"
        )
    try:
        if about["network"] == "field":
            if list(about["sources"]) != list(names()):
                raise ValueError("other basis functions than this version has; train again")
            seen, unseen = (weights[name].astype(np.float64) for name in ("seen", "unseen"))
            return FieldCorrector(seen, unseen, list(about["known"]), float(about["trust_limit"]))
        if about["network"] == "paper":
            from corrector.paper import PaperCorrector  # here: it loads PyTorch

            return PaperCorrector.of(weights, about)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: not weights that this version reads ({type(error).__name__}: {error})") from None
    raise InputError(f"{path}: network {about['network']}; expected field or paper")
