"""The simulator of cloth with laced muscles: constraints with compliances, solved to convergence by implicit steps."""

from sim.kernels import fields  # noqa: F401 first: it starts taichi without a word, or says what it lacks

from sim.motion import SimulatedMotion  # isort: skip
from sim.simulator import Simulator  # isort: skip

__all__ = ["SimulatedMotion", "Simulator"]
