"""What is being edited, kept beside its file until it is saved: a crash or a closed window loses nothing."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from fabdesign.content import sha256
from fabdesign.design import Design
from fabdesign.design_file import read_design
from fabdesign.errors import InputError
from fabdesign.json_file import read_json, write_json
from fabdesign.muscle import Muscle
from studies.studio.layout import Layout

FORMAT = "fabdesign.studio-autosave/1"


class Autosave:
    """The autosave of one file. It holds muscles and pressures, which is all that the studio changes, and the hash of
    the file that they were begun on."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.path = file.with_name(f".{file.name}.studio")
        self._written: Layout | None = None

    def write(self, layout: Layout) -> None:
        """Once for each layout. Raises InputError where nothing can be written."""
        if layout == self._written:
            return
        content = {
            "format": FORMAT,
            "begun_on": content_hash(self._file),
            "muscles": [asdict(muscle) for muscle in layout.design.muscles],
            "pressures_pa": list(layout.pressures),
        }
        write_json(self.path, content)
        self._written = layout

    def read(self, design: Design) -> tuple[Layout, bool] | None:
        """The layout that was left, on the cloth and the muscle types of `design`, and whether the file is still the
        one it was begun on; None where nothing was left, or nothing that fits."""
        try:
            content = read_json(self.path)
            if content["format"] != FORMAT:
                return None
            muscles = tuple(_muscle(entry, design) for entry in content["muscles"])
            pressures = tuple(float(pressure) for pressure in content["pressures_pa"])
            begun_on = content["begun_on"]
        except (ValueError, KeyError, TypeError, AttributeError):
            return None
        return Layout.of(replace(design, muscles=muscles), pressures), begun_on == content_hash(self._file)

    def clear(self) -> None:
        self.path.unlink(missing_ok=True)
        self._written = None


def _muscle(entry: dict[str, Any], design: Design) -> Muscle:
    muscle = Muscle(
        str(entry["type"]),
        "back" if entry["side"] == "back" else "front",
        int(entry["channel"]),
        tuple((float(u), float(v)) for u, v in entry["path"]),
        float(entry["fixed_point_pitch"]),
    )
    fabric = design.fabric
    inside = all(0 <= u <= fabric.width and 0 <= v <= fabric.height for u, v in muscle.path)
    if muscle.type not in design.muscle_types or not inside or len(muscle.path) < 2 or muscle.channel < 0:
        raise InputError(f"an autosaved muscle of type {muscle.type}: expected one that fits the design")
    return muscle


def content_hash(file: Path) -> str | None:
    """sha256 of a file; None where it is not there."""
    try:
        return sha256(file)
    except OSError:
        return None


class Watched:
    """Notices when a file's content becomes another, once for each change. A file that goes, or was never there, is no
    change."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.seen()

    def seen(self) -> None:
        """What is there now is known."""
        self._hash, self._stamp = content_hash(self._file), self._stamped()

    def changed(self) -> bool:
        stamp = self._stamped()
        if stamp == self._stamp:
            return False
        before = self._hash
        self.seen()
        return self._hash is not None and self._hash != before

    def read(self) -> Design:
        """Raises InputError."""
        self.seen()
        return read_design(self._file)

    def _stamped(self) -> tuple[int, int] | None:
        try:
            status = self._file.stat()
        except OSError:
            return None
        return status.st_mtime_ns, status.st_size
