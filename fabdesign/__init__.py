"""Fabric actuators: cloth, McKibben muscles, designs, measured data, their files, and the command line.

Inside, everything is SI (Pa); files and the command line use kPa.
"""

__version__ = "0.1.0"
SIMULATOR = "2"  # counts changes of the simulator that move motions: factors fitted with another one may not fit
