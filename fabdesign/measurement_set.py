"""Measurement sets: a folder with `set.toml`, `fabdesign.measurement-set/1`."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import tomlkit

from fabdesign.design import Design
from fabdesign.design_file import read_design, write_design
from fabdesign.errors import InputError
from fabdesign.json_file import plain
from fabdesign.output import Inputs, new_folder
from fabdesign.rig_limits_file import read_rig_limits
from fabdesign.table import Table, load_toml, nearest
from fabdesign.toml_file import file_stem
from fabdesign.trial import USUAL, Accuracy, MeasurementSet, Role, Trial
from fabdesign.trial_file import TrialData, write_trial

__all__ = ["MeasurementSet", "NewTrial", "Trial", "TrialData", "read_set", "write_set"]

FORMAT = "fabdesign.measurement-set/1"


def read_set(path: Path | str) -> MeasurementSet:
    """Read a set: its folder or its `set.toml`. Designs are read now, trials when asked for, but must be there.

    Raises InputError.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "set.toml"
    root = load_toml(path, FORMAT)
    name = root.text("name", path.resolve().parent.name)
    description = root.text("description", "")
    frame_rate = root.number("frame_rate", None, above=0)
    accuracy = _accuracy(root.table("accuracy", None))
    limits = read_rig_limits(root, path)
    files = root.table("designs")
    designs = {key: read_design(files.path(key, path.parent)) for key in files.names()}
    trials: list[Trial] = []
    for table in root.tables("trials"):
        design_name = table.text("design")
        if design_name not in designs:
            raise table.bad("design", f"one of [designs], {', '.join(designs)}{nearest(design_name, [*designs])}")
        file = table.path("file", path.parent)
        if not file.is_file():
            raise InputError(f"{table.where}: file {file} is not there")
        if any(file.name == trial.file.name for trial in trials):
            raise InputError(f"{table.where}: file name {file.name} is taken by another trial")
        role: Role = table.text("role", choices=("fit", "test"))
        order = table.integer("order")
        for other in trials:
            if (other.design_name, other.order) == (design_name, order):
                raise InputError(
                    f"{table.where}: order = {order} is that of {other.file.name} too; expected each trial's own place "
                    f"in the session of {design_name}"
                )
        trials.append(Trial(file, design_name, designs[design_name], order, role))
        table.finish()
    root.finish()
    if not trials:
        raise InputError(f"{path}: no [[trials]]")
    return MeasurementSet(name, designs, tuple(trials), description, frame_rate, accuracy, limits)


def _accuracy(table: Table | None) -> Accuracy:
    if table is None:
        return USUAL
    pressure = table.number("pressure", USUAL.pressure, least=0, most=1)
    tilt = table.number("tilt_deg", USUAL.tilt, least=0, most=45)
    table.finish()
    return Accuracy(pressure, tilt)


@dataclass(frozen=True)
class NewTrial:
    """A trial to be written."""

    name: str  # of its file, without .npz
    design_name: str
    order: int
    role: Role
    data: TrialData


def write_set(
    folder: Path | str,
    designs: Mapping[str, Design],
    trials: Iterable[NewTrial],
    *,
    name: str,
    description: str = "",
    frame_rate: float | None = None,
    accuracy: Accuracy = USUAL,
    scale: float = 1e-4,
    made_by: str = "write_set",
    force: bool = False,
    inputs: Inputs = (),
) -> None:
    """Write a set, whole or not at all; `trials` may be a generator, one is held at a time.

    Points are stored in units of `scale` [m]. made_by, force, inputs: as `new_folder` takes them. Raises InputError
    like it.
    """
    document = tomlkit.document()
    document["format"] = FORMAT
    document["name"] = name
    if description:
        document["description"] = description
    if frame_rate is not None:
        rate = tomlkit.float_(repr(float(frame_rate)))
        rate.comment("Hz")
        document["frame_rate"] = rate
    if accuracy != USUAL:
        document["accuracy"] = plain(accuracy)
    document["designs"] = {key: f"{file_stem(key)}.toml" for key in designs}
    listed = tomlkit.aot()
    with new_folder(folder, made_by=made_by, force=force, inputs=inputs) as unfinished:
        for key, design in designs.items():
            write_design(design, unfinished / f"{file_stem(key)}.toml")
        for trial in trials:
            file = f"trials/{file_stem(trial.name)}.npz"
            write_trial(trial.data, unfinished / file, scale=scale)
            entry = tomlkit.table()
            entry.update({"file": file, "design": trial.design_name, "order": trial.order, "role": trial.role})
            listed.append(entry)
        document["trials"] = listed
        (unfinished / "set.toml").write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")
