"""Is a file, set or recording sound? Every problem in one line."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path

from fabdesign.bench_file import read_bench
from fabdesign.bench_table_file import read_bench_table
from fabdesign.cloud_file import read_cloud
from fabdesign.design_file import read_design
from fabdesign.errors import InputError
from fabdesign.measurement_set import MeasurementSet, read_set
from fabdesign.model_file import read_model
from fabdesign.pressure_file import read_csv
from fabdesign.recording import Recording, read_recording
from fabdesign.study_file import read_study
from fabdesign.table import nearest, parse_toml, read_text
from fabdesign.trial_file import read_trial

_STUDY = "fabdesign.study/1"  # whose file may leave the line out
# by the `format` line of a TOML file; what has none goes by its name
_READERS: Mapping[str, Callable[[Path], object]] = {
    "fabdesign.design/1": read_design,
    "fabdesign.model/1": read_model,
    "fabdesign.bench/1": read_bench,
    "fabdesign.recording/1": read_recording,
    _STUDY: read_study,
    "fabdesign.measurement-set/1": read_set,
    "trial": read_trial,
    "cloud": read_cloud,
    "pressures": read_csv,
    "bench table": read_bench_table,
}
_FOLDERS = ("set.toml", "recording.toml", "bench.toml", "model.toml")


def problems(path: Path) -> list[str]:
    """What is wrong with a file or folder, a line each; empty where it is sound. Of a set
    every trial is read, of a recording every cloud."""
    try:
        if path.is_dir():
            path = _main_file(path)
        kind = _kind(path)
        content = _READERS[kind](path)
        if isinstance(content, MeasurementSet):
            return _failures(trial.load for trial in content.trials)
        if isinstance(content, Recording):
            return _failures(_clouds(content))
        return []
    except InputError as error:
        return [str(error)]


def _main_file(folder: Path) -> Path:
    for name in _FOLDERS:
        if (folder / name).is_file():
            return folder / name
    raise InputError(f"{folder}: a folder without {', '.join(_FOLDERS)}")


def _kind(path: Path) -> str:
    if path.suffix == ".npz":
        return "trial"
    if path.suffix == ".ply":
        return "cloud"
    if path.suffix == ".csv":
        return "bench table" if read_text(path).startswith("pressure_kpa") else "pressures"
    root = parse_toml(path)
    form = root.get("format", _STUDY if "kind" in root else None)
    known = [kind for kind in _READERS if "/" in kind]
    if form not in known:
        shown = "no format line" if form is None else f'format is "{form}"'
        raise InputError(f"{path}: {shown}; expected one of {', '.join(known)}{nearest(str(form), known)}")
    return str(form)


def _clouds(recording: Recording) -> Iterator[Callable[[], object]]:
    for sensor in recording.sensors:
        if recording.has_reference():
            yield partial(recording.reference, sensor)
        for index in range(len(recording.times)):
            yield partial(recording.frame, sensor, index)


def _failures(reads: Iterable[Callable[[], object]]) -> list[str]:
    found = []
    for read in reads:
        try:
            read()
        except InputError as error:
            found.append(str(error))
    return found
