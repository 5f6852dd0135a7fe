"""One specimen: its ground truth, `fabdesign.key/1`, which is never written into a set; and its motion: a design, that
truth and a pressure program give the cloth's shape at every frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from fabdesign.effects.registry import effect_named
from fabdesign.errors import InputError
from fabdesign.formats.codec import as_number, decode
from fabdesign.formats.schema import FROM_0, FileUnit, Key, Metre, Within
from fabdesign.formats.table import Table, load_toml, nearest
from fabdesign.nouns import muscle_law
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import FACTOR_RANGE, PARAMETERS
from fabdesign.nouns.model import Quantity
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.output import atomic_file
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.store import kept, user_cache
from studies.rig.effects import EFFECTS
from studies.rig.effects.listed import OF_CLOUDS
from studies.rig.motion import RigDiverged, run
from studies.rig.scene import DEFAULT, Resolution, Scene

FORMAT = "fabdesign.key/1"
MECHANICS = ("shell", "cables", "scene", "motion", "specimen")  # what a motion depends on


@dataclass(frozen=True)
class Sensing:
    """The point sensor of a measurement set."""

    frame_rate: Annotated[float, FileUnit("Hz"), Within(above=0, most=1000)] = 30.0
    points: Annotated[int, Within(least=1, most=100_000), "a frame, both faces"] = 1500
    noise: Annotated[Metre, Key("noise_m"), Within(least=0, most=0.1), "an axis"] = 0.0006
    strays: Annotated[float, Within(least=0, most=0.5), "share of points that are not on the cloth"] = 0.003
    ripple: Annotated[float, Within(least=0, most=1), "of the depth cameras of a recording, pixels of disparity"] = 0.0


def _factor(value: Any, table: Table) -> float | None:
    """Return the number, or the `factor` of a table as in a model file."""
    if isinstance(value, Mapping) and value.keys() <= {"factor", "interval90", "reliable", "believable"}:
        value = value.get("factor")
    number = as_number(value)
    return number if number is not None and FACTOR_RANGE[0] <= number <= FACTOR_RANGE[1] else None


def _quantities(value: Any, table: Table) -> dict[str, float] | None:
    """Return parameters of an effect, NAME = 0.1 in the declared unit or { value = 0.1, unit = "s" } in that unit."""
    name = table.find("name")
    if not isinstance(value, Mapping) or name not in EFFECTS:
        return None if name in EFFECTS else {}
    declared, inner, values = EFFECTS[name].parameters, table.inner("parameters"), {}
    for parameter, given in value.items():
        if parameter not in declared:
            known = ", ".join(f"{p} [{unit}]" for p, (_, unit) in declared.items())
            raise inner.error(f"{name} has no parameter {parameter}; it has {known}")
        unit = declared[parameter][1]
        with_unit = {"value": given, "unit": unit} if not isinstance(given, Mapping) else {"unit": unit, **given}
        amount = decode(Quantity, Table(with_unit, f"{inner.where}: {parameter}"))
        if amount.unit != unit:
            raise inner.inner(parameter).bad("unit", f'"{unit}"')
        values[parameter] = amount.value
    return values


_FACTOR = f"a number from {FACTOR_RANGE[0]:g} to {FACTOR_RANGE[1]:g}"


@dataclass(frozen=True)
class EffectSetting:
    """An effect that is on; its parameters in the units that the effect declares."""

    name: Annotated[str, "one of those that the rig has (rig.md)"]
    parameters: Annotated[Mapping[str, float], Key(read=_quantities, expected="a table"), "in declared units"] = field(
        default_factory=dict
    )

    def resolved(self, table: Table) -> "EffectSetting":
        """Raise InputError for an effect that the rig does not have."""
        if self.name not in EFFECTS:
            known = ", ".join(EFFECTS)
            raise table.error(f"unknown effect {self.name}{nearest(self.name, [*EFFECTS])}; known: {known}")
        return self


PLAIN_SENSING = Sensing()


@dataclass(frozen=True)
class GroundTruth:
    """Seed, true parameter factors (names of fabdesign.nouns.forward.PARAMETERS), effects and sensing."""

    seed: Annotated[int, FROM_0, "of noise"] = 0
    parameters: Annotated[
        Mapping[str, Annotated[float, Key(read=_factor, expected=_FACTOR)]], "factors, as in a model"
    ] = field(default_factory=dict)
    effects: tuple[EffectSetting, ...] = ()
    sensing: Sensing = PLAIN_SENSING

    def resolved(self, table: Table) -> "GroundTruth":
        """Raise InputError for an unknown parameter."""
        for name in self.parameters:
            if name not in PARAMETERS:
                raise table.inner("parameters").error(f"unknown parameter {name}{nearest(name, PARAMETERS)}")
        return self


def with_effects_of(design: Design, truth: GroundTruth) -> GroundTruth:
    """Return the ground truth with the effects of the design's benches, where it does not set the same effect itself.

    Raises InputError for one that the rig does not have, or that belongs to one of several muscle types.
    """
    types = {f"muscle_types.{muscle.type}" for muscle in design.muscles}
    settings = []
    for term in design.effects:
        absent = term.scope not in (None, "fabric", *types)  # of a muscle type that has no muscle here
        if absent or any(setting.name == term.name for setting in truth.effects):
            continue
        where = f"design {design.name}: effect {term.name}"
        declared = effect_named(term.name, where).parameters
        values = {name: term.values.get(name, parameter.typical) for name, parameter in declared.items()}
        known = EFFECTS[term.name].parameters if term.name in EFFECTS else {}
        if not known or any(value for name, value in values.items() if name not in known):
            raise InputError(f"{where}: the virtual rig does not have it; expected a design without it")
        if term.scope in types and len(types) > 1:
            raise InputError(f"{where}: belongs to {term.scope}; expected all muscles of one type, on the rig")
        settings.append(EffectSetting(term.name, {name: values[name] for name in known}))
    return replace(truth, effects=(*settings, *truth.effects))


def read_ground_truth(path: Path | str) -> GroundTruth:
    """Read a ground truth file. Raises InputError."""
    return decode(GroundTruth, load_toml(Path(path), FORMAT))


@dataclass(frozen=True, eq=False)
class TrialTask:
    """One trial to run."""

    design: Design
    program: PressureProgram
    times: Array  # (T,) s, the frames
    order: int
    truth: GroundTruth
    resolution: Resolution = DEFAULT


def prepare(task: TrialTask) -> Scene:
    """Return the scene with the ground truth's factors and effects in it."""
    scene = Scene(
        task.design,
        task.truth.parameters,
        task.resolution,
        max_pressure=float(task.program.pressure.max(initial=0.0)),
        seed=1000 * task.truth.seed + task.order,
    )
    for setting in task.truth.effects:
        effect = EFFECTS[setting.name]
        values = {name: default for name, (default, _) in effect.parameters.items()}
        effect.apply(scene, task.order, values | dict(setting.parameters))
    return scene


def control_points(task: TrialTask) -> Array:
    """Return (T, n, 3) control points [m] at the frames. From the cache where the same task has run before.

    Raises RigDiverged where even a quarter of the time step finds no solution.
    """
    return kept(user_cache("rig") / f"{digest_of(task)}.npy", lambda: computed_points(task), np.load, _write_points)


def _write_points(file: Path, points: Array) -> None:
    with atomic_file(file, needed=points.nbytes) as temporary, temporary.open("wb") as stream:
        np.save(stream, points)


def computed_points(task: TrialTask, refinement: int = 1) -> Array:
    scene = prepare(task)
    h = task.resolution.step / refinement
    end = float(task.times[-1]) + max(scene.time_shift, 0.0)
    steps = 1 + max(2, int(np.ceil(end / h - 1e-9)))
    edges = np.asarray((np.arange(steps + 2) - 1.5) * h, dtype=float)  # half a step from the instants
    try:
        motion = run(scene, task.program.means(edges), h, start=-h)
    except RigDiverged:
        if refinement == 4:
            raise
        return computed_points(task, 2 * refinement)
    return np.array([motion.at(max(t + scene.time_shift, 0.0)) for t in task.times])


def digest_of(task: TrialTask) -> str:
    """Return the hash of everything that a motion depends on, the code of its mechanics included."""
    parts = [task.design, task.order, task.truth.seed, sorted(task.truth.parameters.items()), task.resolution]
    parts += [(e.name, sorted(e.parameters.items())) for e in task.truth.effects if e.name not in OF_CLOUDS]
    arrays = [np.asarray(array, np.float64) for array in (task.program.time, task.program.pressure, task.times)]
    here = Path(__file__).parent
    sources = [here / f"{name}.py" for name in MECHANICS] + sorted((here / "effects").glob("*.py"))
    return sha256(*map(repr, parts), *arrays, *sources, Path(str(muscle_law.__file__)))[:32]
