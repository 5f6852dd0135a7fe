"""The kinds of files that commands read: how it is recognised, and what is asked of it. Of those that dataclasses
declare come `fabdesign schema` and the tables of keys in the docs."""

import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.cloud_file import KINDS as CLOUDS
from fabdesign.clouds.recording import RecordingKeys, read_recording
from fabdesign.clouds.target_file import AS_GIVEN, AsTarget, keys_as_options, read_target
from fabdesign.clouds.xyz import is_text_cloud
from fabdesign.errors import InputError, InputNote
from fabdesign.files import law_tables
from fabdesign.files.bench_file import BenchKeys, read_record
from fabdesign.files.design_file import DesignHead, DesignScene, is_part, read_design, read_part
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.files.motion_file import read_motion
from fabdesign.files.pressure_file import TABLES, read_csv, read_pressures
from fabdesign.files.trial_file import read_trial
from fabdesign.formats.csv_table import read_raw_table
from fabdesign.formats.lab_table import parse_heading, parse_units_row, unit_of
from fabdesign.formats.npz_file import open_npz
from fabdesign.formats.schema import json_schema
from fabdesign.formats.table import nearest
from fabdesign.formats.toml_file import parse_toml
from fabdesign.nouns.design import Design
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.model import Model
from fabdesign.nouns.model_sampling import joint_root
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.study_files.study_file import StudyHead
from studies.check.design import (
    STUDIES,
    bench_findings,
    bench_table_lines,
    design_findings,
    part_findings,
    study_findings,
)
from studies.check.findings import FACTOR, PRESSURE, Findings, beyond, failures
from studies.rig import GroundTruth, read_ground_truth

KINDS: Mapping[str, tuple[type, ...]] = {
    "design": (DesignHead, DesignScene, Design),
    "model": (Model,),
    "study": (StudyHead,),  # with those of one of STUDIES
    "measurement-set": (MeasurementSet,),
    "recording": (RecordingKeys,),
    "bench": (BenchKeys,),
    "bench-law": (law_tables.BenchLaw,),
    "key": (GroundTruth,),
}
_STUDY = "fabdesign.study/1"  # whose file may leave the line out
_DESIGN = "fabdesign.design/1"  # as may a file that designs include
_FOLDERS = ("set.toml", "recording.toml", "bench.toml", "model.toml", "design.toml")
_LARGEST = 10.0  # m across, of a cloud in metres
_LATE = 10.0  # intervals between frames: a first frame later than so many is no first one
_OTHER = 1.5  # times the interval that a set's frame rate says
_SLOW = 8.0  # s between rows of a program or frames of a motion, from which milliseconds are likelier


def inspect(path: Path, how: AsTarget = AS_GIVEN) -> Findings:
    """Return everything that is wrong with a file or folder, what is implausible, and what was left out or read
    otherwise than as the format has it. Of a set every trial is read, of a recording every cloud, of a study every
    target. how: a cloud or mesh is to be a target; with a fabric also where it lies on that."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", InputNote)
        findings = _inspect(path, how)
    return findings + Findings(notes=tuple(str(each.message) for each in caught))


def _inspect(path: Path, how: AsTarget) -> Findings:
    try:
        if path.is_dir():
            return _folder(path)
        if not path.exists():
            raise InputError(f"{path}: no such file")
        suffix = path.suffix.lower()
        if suffix == ".npz":
            return _npz(path, how)
        if suffix in TABLES:
            return _table(path, how)
        if suffix in CLOUDS:
            return _cloud(path, how)
        return _BY_FORMAT[_format(path)](path)
    except InputError as error:
        return Findings((str(error),))
    except OSError as error:  # a name that is too long, a folder that may not be read
        return Findings((f"{path}: cannot be read ({error.strerror})",))


def _folder(path: Path) -> Findings:
    main = next((path / name for name in _FOLDERS if (path / name).is_file()), None)
    if main is None:
        raise InputError(f"{path}: a folder without {', '.join(_FOLDERS)}")
    findings = _BY_FORMAT[_format(main)](main)
    pressures = sorted(path.glob("pressures*.csv")) if main.name == "design.toml" and not findings.problems else []
    return findings + failures(partial(read_pressures, file, read_design(main)) for file in pressures)


def _format(path: Path) -> str:
    root = parse_toml(path)
    usual = _STUDY if "kind" in root else _DESIGN if {"fabric", "muscle_types"} & root.keys() else None
    form = root.get("format", usual if usual == _STUDY or not {"muscles", "include"} & root.keys() else None)
    if not isinstance(form, str) or form not in _BY_FORMAT:
        shown = "no format line" if form is None else f'format is "{form}"'
        known = [*_BY_FORMAT]
        raise InputError(f"{path}: {shown}; expected one of {', '.join(known)}{nearest(str(form), known)}")
    return str(form)


def _design(path: Path) -> Findings:
    if is_part(path):
        return part_findings(read_part(path), str(path))
    return design_findings(read_design(path), str(path))


def _set(path: Path) -> Findings:
    measured = read_set(path)
    findings = Findings()
    for name, design in measured.designs.items():
        findings += design_findings(design, f"{path}: designs.{name}")
    seen: dict[bytes, Path] = {}
    for trial in measured.trials:
        try:
            findings += _repeats(trial.load().frames, trial.file, seen)
        except InputError as error:
            findings += Findings((str(error),))
        try:
            findings += _programs(trial.program, str(trial.file), measured_at=trial.times)
            interval = float(np.median(np.diff(trial.times))) if len(trial.times) > 1 else 0.0
        except InputError:
            continue  # `load` has said so
        lines = []
        if measured.frame_rate and interval and not 1 / _OTHER < interval * measured.frame_rate < _OTHER:
            lines.append(f"a frame every {interval:.3g} s; set.toml says frame_rate = {measured.frame_rate:g} Hz")
        if interval and trial.times[0] > _LATE * interval:
            first = f"its first frame is {trial.times[0]:.3g} s after rest, the next {interval:.3g} s on"
            lines.append(f"{first} (does time begin at rest?)")
        findings += Findings.warned(trial.file, lines)
    return findings


def _repeats(frames: Sequence[NDArray[np.float64]], file: Path, seen: dict[bytes, Path]) -> Findings:
    """Return what noise never does: frames equal to the one before, and those of a trial `seen` under another name."""
    lines = []
    hashes = [hashlib.sha256(frame.tobytes()).digest() for frame in frames]
    if count := sum(a == b for a, b in pairwise(hashes)):
        lines.append(f"{count} of {len(frames)} frames repeat the one before (did the sensor stop?)")
    if (same := seen.setdefault(b"".join(hashes), file)) != file:
        lines.append(f"has the frames of {same}; a trial counts once, and on one side of a split")
    return Findings.warned(file, lines)


def _recording(path: Path) -> Findings:
    recording = read_recording(path)
    findings = design_findings(recording.design, f"{path}: design")
    for sensor in recording.sensors:
        reads: list[Callable[[], object]] = []
        if recording.has_reference():
            reads.append(partial(recording.reference, sensor))
        reads += [partial(recording.frame, sensor, index) for index in range(len(recording.times))]
        findings += failures(reads)
    return findings + _programs(recording.program, str(recording.folder / "pressure.csv"), measured_at=recording.times)


def _model(path: Path) -> Findings:
    model = read_model(path)
    lines = [line for name, factor in model.factors.items() for line in beyond(f"{name}: factor", factor, FACTOR)]
    for name, parameter in model.parameters.items():
        low, high = parameter.interval90 or (parameter.factor, parameter.factor)
        if not low <= parameter.factor <= high:
            lines.append(f"{name}: factor = {parameter.factor:g} lies outside its interval90, {low:g} to {high:g}")
    sound = failures([partial(joint_root, model)]) if model.covariance is not None else Findings()
    lines += sound.problems
    return Findings.warned(path, lines)


def _key(path: Path) -> Findings:
    truth = read_ground_truth(path)
    lines = [line for name, factor in truth.parameters.items() for line in beyond(name, factor, FACTOR)]
    return Findings.warned(f"{path}: parameters", lines)


def _npz(path: Path, how: AsTarget) -> Findings:
    with open_npz(path, "a trial's, a motion's or a cloud's arrays") as arrays:
        trial, dimensions = "offsets" in arrays, len(arrays.shape("points"))
    if trial:
        return _programs(read_trial(path).program, str(path))
    if dimensions == 3:
        return Findings.warned(path, _slow(read_motion(path).time, "frames"))
    return _cloud(path, how)


def _cloud(path: Path, how: AsTarget) -> Findings:
    """Check a cloud or mesh, which may stand in any unit and frame: options or a study say which."""
    if how.fabric is not None:
        with keys_as_options():
            placed = read_target(how.target(path), how.fabric)
        return Findings(notes=(f"{path}: lies on the cloth with {placed.placement}",))
    far = float(np.linalg.norm(np.ptp(how.read(path).points, axis=0)))
    line = f'{path}: is {far:.3g} m across; a cloth is not (in millimetres: --unit mm, and unit = "mm" in a study)'
    return Findings(warnings=(line,) if far > _LARGEST else ())


def fabric_of(files: Sequence[Path]) -> Fabric | None:
    """Return the cloth of the one design among files; None where there is none. Raises InputError for several."""
    designs = []
    for file in (file for file in files if file.suffix.lower() == ".toml" and file.is_file()):
        with suppress(InputError):  # said where it is checked
            designs += [file] if _format(file) == _DESIGN and not is_part(file) else []
    if len(designs) > 1:
        raise InputError(f"{designs[1]}: a second design beside {designs[0]}; expected one, which targets lie on")
    return read_design(designs[0]).fabric if designs else None


def _table(path: Path, how: AsTarget) -> Findings:
    """Return the findings of a text table, by what its headings measure."""
    if is_text_cloud(path):
        return _cloud(path, how)
    raw = read_raw_table(path)
    header = raw.header
    headings = [parse_heading(text) for text in header]
    specimen = next((specimen for specimen, columns in law_tables.TABLES.items() if header == [*columns]), None)
    if specimen is not None:
        law_tables.read_law_table(path, specimen)
        return Findings()
    measured = {heading.quantity for heading in headings} | {heading.name for heading in headings}
    symbols = parse_units_row(raw.rows[0][1]) or [heading.symbol or "" for heading in headings]
    measured |= {unit.dimension for symbol in symbols if (unit := unit_of(symbol)) is not None}
    if {"pressure", "contraction", "force"} <= measured and "time" not in measured:
        return Findings.warned(path, bench_table_lines(law_tables.read_bench_table(path)))
    if {"strain", "tension"} <= measured:
        law_tables.read_membrane_curve(path)
        return Findings()
    if measured & {"stretch", "force", "load", "displacement", "contraction"}:
        read_record(path)
        return Findings()
    if not {"time", "channel_0"} & measured:
        raise InputError(
            f"{path}: columns are {','.join(header)}; expected pressures (time_s,channel_0,...), a bench table "
            f"({','.join(law_tables.BENCH_COLUMNS)}), a membrane curve (strain,tension_n_per_m), a bench record or a "
            "cloud (x,y,z)"
        )
    return _programs(read_csv(path), str(path))


def _programs(program: PressureProgram, where: str, *, measured_at: object = None) -> Findings:
    """Return what is implausible in set points."""
    largest = float(program.pressure.max(initial=0.0))
    lines = [*beyond("largest pressure", largest, PRESSURE)] if largest > 0 else []
    if measured_at is None:
        lines += _slow(program.time, "rows")
    return Findings.warned(where, lines)


def _slow(time: NDArray[np.float64], what: str) -> list[str]:
    """Return a line about times [s] of rows or frames that may be milliseconds."""
    interval = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    return [f"{what} lie {interval:.4g} s apart; expected seconds (is it in ms?)"] if interval >= _SLOW else []


_BY_FORMAT: Mapping[str, Callable[[Path], Findings]] = {
    _DESIGN: _design,
    "fabdesign.model/1": _model,
    "fabdesign.bench/1": bench_findings,
    "fabdesign.bench-law/1": lambda path: failures([partial(law_tables.read_bench_law, path)]),
    "fabdesign.recording/1": _recording,
    _STUDY: study_findings,
    "fabdesign.measurement-set/1": _set,
    "fabdesign.key/1": _key,
}


def schema_of(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of one of KINDS. Raises InputError for any other."""
    if kind not in KINDS:
        raise InputError(f"schema {kind}: expected one of {', '.join(KINDS)}{nearest(kind, [*KINDS])}")
    if kind == "study":
        studies = [json_schema("study", (StudyHead, form), required=()) for form in STUDIES.values()]
        for name, study in zip(STUDIES, studies, strict=True):
            study["properties"]["kind"] = {"const": name}
        return {"$schema": studies[0].pop("$schema"), "title": studies[0]["title"], "oneOf": studies}
    schema = json_schema(kind, KINDS[kind])
    if kind == "design":  # a file that others include has some of its keys
        del schema["properties"]["fabric"]["required"]
        schema["required"] = []
    return schema
