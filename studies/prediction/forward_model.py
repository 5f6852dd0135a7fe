"""A simulator and a model become the one forward model that every study asks."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from fabdesign.effects.registry import effect_named
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.predictor import Predictor
from fabdesign.nouns.pressure import PressureProgram


def forward_model(simulator: ForwardModel, model: Model | None, *, sensing: bool = False) -> Predictor:
    """Return `simulator` with all of `model`: factors, effects, corrector, and where asked for what its sensors add.

    Raises InputError for a model with a part that cannot be used.
    """
    model = model or Model()
    if model.corrector is None:
        return Predictor(simulator, model, sensing)
    from corrector import load_corrector  # a few milliseconds that only a model with one costs

    return Predictor(simulator, model, sensing, load_corrector(model))


def without_resistance(predictor: Predictor) -> Predictor | None:
    """Return what derivatives of shapes at rest are cheap of and near the model's, where it has forces against motion,
    for which the simulator has no tangent; None where it has none."""
    kept = unresisted(predictor.model)
    return None if kept == predictor.model else replace(predictor, model=kept)


def unresisted(model: Model) -> Model:
    """Return the model less its forces against motion."""
    return replace(
        model, effects=tuple(term for term in model.effects if not effect_named(term.name, "effects").resists)
    )


def not_corrected(model: Model, designs: Iterable[Design]) -> list[str]:
    """Return a line on each design that the model's corrector declines, and why: its motions are the simulator's."""
    if model.corrector is None:
        return []
    from corrector import load_corrector

    corrector, lines = load_corrector(model), []
    for name, design in {design.name: design for design in designs}.items():
        trust = corrector.trust(design)
        if not trust.applies:
            lines.append(
                f"{name}: not corrected: {trust.distance:.2f} from the designs that the corrector learned from, more "
                f"than its limit of {trust.limit:.2f}; its motions are the simulator's"
            )
    return lines


def extrapolated(model: Model | None, programs: Sequence[PressureProgram]) -> list[str]:
    """Return a line where the pressures go beyond those that the model's coefficients without a physical name were
    fitted to; none for a model without such coefficients, or whose file does not say what they were fitted to."""
    if model is None or model.learned_range is None:
        return []
    if all(effect_named(term.name, "effects").named for term in model.effects):
        return []
    line = model.learned_range.beyond(programs)
    return [] if line is None else [line]
