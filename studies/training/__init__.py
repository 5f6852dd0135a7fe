"""Training a corrector on measured sets (docs/corrector.md). Belongs here: trials, motions and folds; what is learned
is `corrector`."""

from studies.training.data import TrainingOptions
from studies.training.train import train_on

__all__ = ["TrainingOptions", "train_on"]
