"""Measurement sets: a folder with `set.toml`, `fabdesign.measurement-set/1`."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import tomlkit
from tomlkit.items import Item

from fabdesign.files.design_file import write_design
from fabdesign.files.trial_file import TrialData, write_trial
from fabdesign.formats.codec import Encoder, decode
from fabdesign.formats.table import load_toml
from fabdesign.formats.toml_file import file_stem
from fabdesign.nouns.design import Design
from fabdesign.nouns.trial import USUAL, Accuracy, MeasurementSet, RecordingTiming, Role, Trial
from fabdesign.output import new_folder

__all__ = ["MeasurementSet", "NewTrial", "Trial", "TrialData", "read_set", "write_set"]

FORMAT = "fabdesign.measurement-set/1"


def read_set(path: Path | str) -> MeasurementSet:
    """Read a set: its folder or its `set.toml`. Designs are read now, trials when asked for, but must be there.

    Raises InputError.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "set.toml"
    return decode(MeasurementSet, load_toml(path, FORMAT))


@dataclass(frozen=True)
class NewTrial:
    """A trial to be written."""

    name: str  # of its file, without .npz
    design_name: str
    order: int
    role: Role
    data: TrialData
    timing: RecordingTiming | None = None  # of the recording that it was fused from


def write_set(
    folder: Path | str,
    designs: Mapping[str, Design],
    trials: Iterable[NewTrial],
    *,
    name: str,
    description: str = "",
    frame_rate: float | None = None,
    accuracy: Accuracy = USUAL,
) -> None:
    """Write a set, whole or not at all; `trials` may be a generator, one is held at a time. Raises InputError like
    `new_folder`."""
    files = (f"{file_stem(key)}.toml" for key in designs)
    listed: list[Trial] = []
    timings: dict[str, RecordingTiming] = {}
    with new_folder(folder, made_by="write_set") as unfinished:
        for key, design in designs.items():
            write_design(design, unfinished / f"{file_stem(key)}.toml")
        for trial in trials:
            file = unfinished / "trials" / f"{file_stem(trial.name)}.npz"
            write_trial(trial.data, file)
            if trial.timing is not None:
                timings[file.stem] = trial.timing
            listed.append(Trial(file, trial.design_name, designs[trial.design_name], trial.order, trial.role))
        measured = MeasurementSet(name, designs, tuple(listed), description, frame_rate, accuracy, recording=timings)
        document = tomlkit.document()
        document["format"] = FORMAT
        document.update(Encoder(unfinished / "set.toml", {Design: lambda design: next(files)}).encode(measured))
        if frame_rate is not None:
            cast(Item, document.item("frame_rate")).comment("Hz")
        (unfinished / "set.toml").write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")
