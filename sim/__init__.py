"""The simulator of cloth with laced muscles: constraints with compliances, solved to convergence by implicit steps."""

from sim.motion import Motion
from sim.simulator import Simulator

__all__ = ["Motion", "Simulator"]
