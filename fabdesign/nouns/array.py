"""The array that most of the code hands on: float64, in SI."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
