"""The simulator: extended position-based dynamics of cloth with laced muscles."""

from sim.motion import Motion
from sim.simulator import Simulator

__all__ = ["Motion", "Simulator"]
