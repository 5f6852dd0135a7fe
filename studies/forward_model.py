"""A simulator and a model become the one forward model that every study asks."""

from fabdesign.forward import ForwardModel
from fabdesign.model import Model
from fabdesign.predictor import Predictor


def forward_model(simulator: ForwardModel, model: Model | None, *, sensing: bool = False) -> Predictor:
    """`simulator` with all of `model`: factors, effects, corrector, and where asked for what its sensors add.

    Raises InputError for a model with a part that cannot be used.
    """
    model = model or Model()
    if model.corrector is None:
        return Predictor(simulator, model, sensing)
    from corrector import load_corrector  # a few milliseconds that only a model with one costs

    return Predictor(simulator, model, sensing, load_corrector(model))
