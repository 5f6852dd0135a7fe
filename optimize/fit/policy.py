"""How a fit goes on and when it ends: policies by name, each of their constants with its reason."""

from dataclasses import dataclass, replace

import numpy as np

from optimize.fit.misfit import FAR
from optimize.fit.significance import NEEDED

STEP = 0.03  # of a logarithm, in the first finite differences: its noise is a tenth of what it shows
ITERATIONS = 20  # at most, of a stage; those that converge take 3 to 9
PROMISED = 0.25  # of the gain that a step promised: while it gains as much, its Jacobian is updated, not made anew
LENGTHS, OTHER_LENGTHS = (1.0, 0.5), (2.0, 0.25)  # of a step
GOOD = 0.9  # of the gain that a step promised: where it gains that, and no more by as much, no other length is tried
WRONG = 2.0  # times what a right model leaves: no last steps are worth their motions
LITTLE = NEEDED / 4  # of log likelihood: an effect that costs less to drop keeps its former column
DAMPING = 0.3  # Levenberg-Marquardt's, after a step that made it worse


@dataclass(frozen=True)
class FitStage:
    """Steps until one is slight, or gains nothing, or promises less than the largest of three gains."""

    slight: float  # of a logarithm: a shorter step is the last
    least: float = 0.0  # of log likelihood, in all
    least_each: float = 0.0  # the same for each unknown
    least_share: float = 0.0  # the same for each observation, where what is left is far more than an unknown could gain
    far: float = FAR  # times the usual residual, over which a frame counts less
    exact_end: bool = True  # whether the last step goes by a Jacobian that was made where it begins


@dataclass(frozen=True)
class Policy:
    """How a fit goes on and ends. begin: the first steps on all rows. end: those after them; None: another fit goes on.
    hopeless: m RMS: where the minimum of the linearised residuals leaves more, the fit ends. content: m RMS: where
    steps that gain too little leave no more, no Jacobian is made anew."""

    begin: FitStage
    end: FitStage | None = None
    hopeless: float = np.inf
    content: float = 0.0


# What a model has not got yet may show in a few frames alone, so none counts less for being far off. A step under 3 %,
# or one that promises under 2 % of what is left, is mended by the fit that goes on.
UNSURE = FitStage(slight=0.03, least=3.0, least_share=0.02, far=np.inf, exact_end=False)
CLOSE = FitStage(slight=0.01, least_each=0.1)  # of log likelihood: under half a standard deviation

ROUGH = Policy(replace(UNSURE, exact_end=True))
DECLARED_ALONE = Policy(UNSURE, end=CLOSE)
# Values are told to 1 %; 0.007 of log likelihood is a tenth of a standard deviation.
END = Policy(UNSURE, end=replace(CLOSE, least_each=0.007))
