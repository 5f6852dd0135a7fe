"""A simulator and a model become the one forward model that every study asks."""

from fabdesign.errors import InputError
from fabdesign.forward import ForwardModel
from fabdesign.model import Model
from fabdesign.predictor import Predictor


def forward_model(simulator: ForwardModel, model: Model | None, *, sensing: bool = False) -> Predictor:
    """`simulator` with all of `model`: factors, effects, corrector, and where asked for what its sensors add.

    Raises InputError for a model with a part that cannot be used.
    """
    model = model or Model()
    if model.corrector is not None:
        raise InputError(f"model: corrector {model.corrector}; this version predicts without a corrector")
    return Predictor(simulator, model, sensing)
