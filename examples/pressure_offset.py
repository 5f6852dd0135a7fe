"""The simplest effect of one's own, in numpy alone: a regulator that gives the same few kPa too much in every channel.

    fabdesign effects pressure_offset --effects examples/pressure_offset.py
    fabdesign calibrate measured_set --free pressure_offset --effects examples/pressure_offset.py -o model.toml
    fabdesign predict measured_set --model model.toml --effects examples/pressure_offset.py -o predicted

A channel at zero stays shut. examples/cloth_creep.py adds a force with memory.
"""

from dataclasses import replace

import numpy as np

from fabdesign.effects import Effect, EffectParameter


def _pressure(acting, values):
    def higher(pressure):
        return np.where(pressure > 0, np.maximum(pressure + 1e3 * values["offset"], 0.0), 0.0)  # Pa

    program = replace(acting.program, pressure=higher(acting.program.pressure))
    return acting.through(program, None if acting.smooth is None else higher(acting.smooth))


PRESSURE_OFFSET = Effect(
    "pressure_offset",
    site="pneumatics",
    scope="rig",
    what="every open channel has `offset` more than it is told",
    signature="as much at every pressure, at hold too; largest where the muscle's law is steepest",
    source="zero error of a regulator's gauge",
    parameters={"offset": EffectParameter("kPa", "added", 10.0, (-50.0, 50.0), 10.0, off=0.0)},
    pressure=_pressure,
)
