"""Fabric actuators: cloth, McKibben muscles, designs, measured data, their files, and the command line.

Inside, everything is SI (Pa); files and the command line use kPa. What a user does is here by name, and loaded when it
is asked for: `fabdesign.simulate`, `equilibrium`, `calibrate`, `evaluate`, `optimize`, `faces_of`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fabdesign.interface import calibrate, equilibrium, evaluate, faces_of, optimize, simulate

__version__ = "0.2.0"
SIMULATOR = "2"  # counts changes of the simulator that move motions: factors fitted with another one may not fit
__all__ = ["calibrate", "equilibrium", "evaluate", "faces_of", "optimize", "simulate"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from fabdesign import interface

    return getattr(interface, name)
