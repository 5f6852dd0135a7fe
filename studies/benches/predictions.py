"""Predictions of a bench's records by a law in a file, and how far these are off, for `calibrate` and `evaluate`."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError
from fabdesign.files.design_file import DesignPart, read_part
from fabdesign.files.law_tables import FORMAT as BENCH_LAW
from fabdesign.files.law_tables import read_bench_law
from fabdesign.formats.toml_file import parse_toml
from fabdesign.nouns.bench import Bench, BenchRecord
from fabdesign.nouns.muscle_law import law_of
from studies.benches.law import Predict
from studies.benches.muscle import of_type
from studies.benches.records import LAWS
from studies.benches.strip import of_strip

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RecordErrors:
    """Root mean squares over a record's rows, in the output's SI unit; of an actuator the level held. before: without
    what motion adds (friction, viscosity, effects)."""

    before: float
    after: float


def errors_of(predict: Predict, bench: Bench, records: Sequence[BenchRecord]) -> list[RecordErrors]:
    """Return the errors of a prediction on records."""

    def errors(record: BenchRecord) -> RecordErrors:
        truth = LAWS[bench.specimen].measured(record)
        return RecordErrors(*(float(np.sqrt(np.mean((values - truth) ** 2))) for values in predict(record)))

    return [errors(record) for record in records]


def prediction(path: Path, bench: Bench) -> Predict:
    """Return what the file says of the bench's records: without and with friction, viscosity, effects.

    Raises InputError for a file of another specimen, and for a cloth where the bench does not state the strip's width.
    """
    if parse_toml(path).get("format") == BENCH_LAW:
        law = read_bench_law(path)
        if law.specimen != bench.specimen:
            raise InputError(f"{path}: the law of specimen {law.specimen}; {bench.file} has {bench.specimen}")
        return LAWS[bench.specimen].read(law)
    part = read_part(path)
    if bench.specimen == "muscle":
        return _of_muscle(part, path, bench)
    if bench.specimen != "strip" or part.fabric is None or (curve := part.fabric.membrane_curve) is None:
        raise InputError(f"{path}: no law of a {bench.specimen}, which {bench.file} has; expected what calibrate wrote")
    width, across = bench.constant("width"), 1 if bench.constants.get("direction") == 2 else 0
    if not curve.strain[across]:
        raise InputError(f"{path}: its curve has no direction {across + 1}, which {bench.file} has")
    strain, force = np.array(curve.strain[across]), width * np.array(curve.tension[across])
    return of_strip(strain, force)


def _of_muscle(part: DesignPart, path: Path, bench: Bench) -> Predict:
    name = bench.name if bench.name in part.types else next(iter(part.types), None)
    if name is None or (name != bench.name and len(part.types) > 1):
        raise InputError(f"{path}: muscle types {', '.join(part.types) or 'none'}; expected one, or {bench.name}")
    muscle = part.types[name]
    terms = tuple(term for term in part.effects if term.scope in (None, f"muscle_types.{name}"))
    return of_type(law_of(muscle.bench), muscle.viscosity, terms)
