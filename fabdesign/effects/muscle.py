"""Effects of muscles: threshold, friction, creep, viscosity, softening, an odd one."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fabdesign.effects.declaration import Effect, EffectParameter, MuscleRecord, Specimen, Values, to_muscles
from fabdesign.nouns.lag import first_order
from fabdesign.units import from_kpa


# Threshold pressure: a muscle's bladder must be blown up before pressure contracts the braid.
def _threshold_pressure_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    threshold, width = from_kpa(values["threshold"]), from_kpa(values["width"])
    # so a threshold of nothing leaves the pressure as it is; from 2 (4) widths on the width is right to 4 (0.1) %
    narrowed = width * np.tanh(threshold / width)
    return specimen.with_muscles(muscles, threshold_pressure=threshold, threshold_width=narrowed)


THRESHOLD_PRESSURE = Effect(
    "threshold_pressure",
    site="muscle",
    scope="muscle type",
    what="p acts as width log(1 + exp((p - threshold) / width)): hardly below the threshold, less by it above; below "
    "two widths of threshold the width narrows with it",
    signature="one curve of the pressure, the same up and down and at any rate; wrong most at low pressures",
    looks_like="a pressure gauge with an offset, or another law of the bench at low pressures; measure the pressure at "
    "the muscle, in steps of 10 kPa",
    source="bladder of a McKibben muscle (Tondu and Lopez 2000, doi:10.1109/37.833638); docs/effects.md",
    parameters={
        "threshold": EffectParameter("kPa", "pressure that does nothing", 40.0, (0.0, 400.0), 20.0, off=0.0),
        "width": EffectParameter("kPa", "of the bend", 10.0, (1.0, 100.0), 0.5, transform="log"),
    },
    specimen=_threshold_pressure_specimen,
    force="sim.effects:THRESHOLD_PRESSURE",
)


# Braid hysteresis: Coulomb friction of strand on strand, which grows with pressure.
def _braid_hysteresis_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    return specimen.with_muscles(
        muscles,
        friction_per_pressure=values["friction"] / from_kpa(1.0),  # N/Pa
        friction_at_zero=values["friction_at_zero"],
        friction_slip=values["slip"],
    )


def _braid_hysteresis_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    limit = values["friction_at_zero"] + values["friction"] / from_kpa(1.0) * record.pressure
    drawn = np.diff(record.contraction, axis=0, prepend=record.contraction[:1])
    force, forces = np.zeros(drawn.shape[1:]), []
    for most, more in zip(limit, drawn, strict=True):
        force = np.clip(force + most / values["slip"] * more, -most, most)
        forces.append(force)
    return replace(record, friction=record.friction + np.array(forces))


BRAID_HYSTERESIS = Effect(
    "braid_hysteresis",
    site="muscle",
    scope="muscle type",
    what="friction against contraction and lengthening, up to friction times pressure: one Maxwell-slip element an "
    "interval, which gives way by `slip` of contraction before it slides",
    signature="branches at equal pressure, as wide at any rate; minor loops; still open at hold",
    looks_like="friction of the cloth with itself, or a pressure sensor with a dead band; cycle one muscle on its "
    "bench by pressure measured at the muscle",
    source="Maxwell-slip model (Iwan 1966, doi:10.1115/1.3625199); docs/effects.md",
    parameters={
        "friction": EffectParameter("N/kPa", "limit by pressure", 0.005, (0.0, 0.1), 0.005, off=0.0),
        "friction_at_zero": EffectParameter("N", "limit without pressure", 0.0, (0.0, 10.0), 0.3, off=0.0),
        "slip": EffectParameter("1", "contraction until it slides", 0.005, (0.0005, 0.1), 0.5, transform="log"),
    },
    specimen=_braid_hysteresis_specimen,
    force="sim.effects:BRAID_HYSTERESIS",
    resists=True,
    bench=_braid_hysteresis_bench,
    remembers=True,
)


# Muscle creep: part of a muscle's contraction comes slowly, and goes slowly.
def _muscle_creep_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    limit = values["share"] * np.maximum(record.contraction, 0.0)
    lent = first_order(limit[1:], np.diff(record.time), values["time"], start=limit[0])
    return replace(record, lent=record.lent + lent - values["on_bench"] * limit)


MUSCLE_CREEP = Effect(
    "muscle_creep",
    site="muscle",
    scope="muscle type",
    what="a slow contraction z, dz/dt = (share max(eps, 0) - z) / time, of which the bench law has the share on_bench, "
    "1 where each of its points was held: F(p, eps - z + on_bench share max(eps, 0))",
    signature="slow extra at hold, slow recovery after; as much for slow and fast ramps once held",
    looks_like="a slow leak, or a muscle that warms; log the pressure over a long hold and repeat at once",
    source="standard linear solid; docs/effects.md",
    parameters={
        "share": EffectParameter("1", "of the contraction, in the end", 0.15, (0.0, 0.8), 0.1, off=0.0),
        "time": EffectParameter("s", "time constant", 0.8, (0.02, 100.0), 0.8, transform="log"),
        "on_bench": EffectParameter(
            "1",
            "of the creep that the bench law has: 1 where the bench held each point",
            0.0,
            (0.0, 1.0),
            1.0,
            tried=(0.5,),
        ),
    },
    specimen=to_muscles(creep_share="share", creep_time="time", creep_on_bench="on_bench"),
    force="sim.effects:MUSCLE_CREEP",
    bench=_muscle_creep_bench,
    remembers=True,
)


# Muscle viscosity: tension lost by the rate of contraction, another share while lengthening.
def _muscle_viscosity_bench(record: MuscleRecord, values: Values) -> MuscleRecord:
    viscosity = np.where(record.rate > 0, values["contracting"], values["lengthening"])
    return replace(record, friction=record.friction + viscosity * record.rate)


MUSCLE_VISCOSITY = Effect(
    "muscle_viscosity",
    site="muscle",
    scope="muscle type",
    what="tension lost by the contraction's rate, beyond the declared viscosity; another share while lengthening",
    signature="in proportion to the rate, nothing at hold; contracting and lengthening differ, as with the cloth's "
    "damping they do not",
    looks_like="a narrow valve, whose pressure lags behind in proportion to the flow; log the pressure at the muscle",
    source="Kelvin-Voigt element with a share for each direction; docs/effects.md",
    parameters={
        "contracting": EffectParameter("N s", "while contracting", 20.0, (0.0, 500.0), 10.0, off=0.0),
        "lengthening": EffectParameter("N s", "while lengthening", 10.0, (0.0, 500.0), 10.0, off=0.0),
    },
    specimen=to_muscles(viscosity_contracting="contracting", viscosity_lengthening="lengthening"),
    force="sim.effects:MUSCLE_VISCOSITY",
    resists=True,
    bench=_muscle_viscosity_bench,
)


# Stroke softening: muscles pull less from trial to trial of a session.
def _stroke_softening_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    remaining = 1.0 + values["loss"] * np.expm1(-specimen.order / values["trials"])
    return specimen.with_muscles(muscles, gain=specimen.muscles["gain"] * remaining)


STROKE_SOFTENING = Effect(
    "stroke_softening",
    site="muscle",
    scope="rig",
    what="what pressure adds to the tension falls with the trial's place k in the session: by loss (1 - exp(-k / "
    "trials))",
    signature="smaller motions from trial to trial, most between the first ones; back after a rest, not within a trial",
    looks_like="a supply that runs empty, or muscles that warm up; log the pressure, and repeat the first trial after "
    "an hour",
    source="softening of the first strokes (Mullins effect, Ogden and Roxburgh 1999); docs/effects.md",
    parameters={
        "loss": EffectParameter("1", "of the gain, in the end", 0.15, (0.0, 0.9), 0.1, off=0.0),
        "trials": EffectParameter("1", "after which 63 % of it is lost", 3.0, (0.2, 100.0), 0.8, transform="log"),
    },
    specimen=_stroke_softening_specimen,
)


# Odd muscle: the muscles of one channel pull with a gain of their own.
def _odd_muscle_specimen(specimen: Specimen, values: Values, muscles: NDArray[np.bool_]) -> Specimen:
    odd = np.array([muscle.channel == int(values["channel"]) for muscle in specimen.design.muscles], dtype=bool)
    return specimen.with_muscles(odd & muscles, gain=specimen.muscles["gain"] * values["factor"])


ODD_MUSCLE = Effect(
    "odd_muscle",
    site="muscle",
    scope="rig",
    what="what pressure adds to the tension is multiplied in one channel's muscles",
    signature="stripes fixed to one muscle, in step with its pressure, whatever the others do",
    looks_like="a regulator of this channel that is out by a share, or a looser lacing; exchange two channels' hoses",
    source="repeat variation of woven muscles, 2 to 4 %; docs/effects.md",
    parameters={
        "channel": EffectParameter("1", "the odd channel, from 0", 0.0, (0.0, 255.0), 1.0, integer=True),
        "factor": EffectParameter("1", "on its gain", 0.8, (0.05, 5.0), 0.2, off=1.0, transform="log"),
    },
    specimen=_odd_muscle_specimen,
    adds_up_to="muscle_gain",
)
