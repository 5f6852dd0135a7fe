"""The simulator: extended position-based dynamics of cloth with laced muscles."""

from sim.simulator import Motion, Simulator

__all__ = ["Motion", "Simulator"]
