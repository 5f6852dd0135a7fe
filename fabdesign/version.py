"""The version of the program, and of its simulator. Loads nothing."""

__version__ = "0.3.0"
SIMULATOR = "2"  # counts changes of the simulator that move motions: factors fitted with another one may not fit
