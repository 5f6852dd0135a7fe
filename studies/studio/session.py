"""One sitting: the document and what follows from it; and its files: the autosave, the file that was opened, the folder
that it is saved in, templates. One thread owns it, the page asks through a queue."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.drawings.sewing import Exported, Sewing, export_design
from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.pressure_file import pressure_file_of, write_pressures
from fabdesign.formats.codec import decode_key
from fabdesign.formats.json_file import read_json, write_json
from fabdesign.formats.table import Table
from fabdesign.nouns.forward import RISE
from fabdesign.nouns.muscle import Muscle
from fabdesign.nouns.pressure import regulated, rising_program
from fabdesign.output import new_folder, read_mark, write_text
from fabdesign.runtime.fingerprint import sha256
from studies.studio.document import Document
from studies.studio.layout import Layout
from studies.studio.opening import Opened
from studies.studio.playing import Playing, ProgramEdit
from studies.studio.search import BackgroundSearch, study_document
from studies.studio.shapes import Shapes

CALM = 0.35  # s without a further value, after which a slider counts as let go
DUE = 1.0  # s between autosaves, and looks at the file and the search
FORMAT = "fabdesign.studio-autosave/1"
SETTLED = 2.0  # s of the motion in pressures.csv after its rise
_TAIL = 0.03  # m, of muscles whose type says nothing


def content_hash(file: Path) -> str | None:
    """Return the sha256 of a file; None where it is not there."""
    try:
        return sha256(file)
    except OSError:
        return None


class Files:
    """Saves, restores and follows the file. folder and template_folder: where the design and its templates go, unless
    other places are typed. autosave: a copy of what is edited, beside the file until it is saved: a crash or a closed
    window loses nothing. It holds muscles and pressures, which is all that the studio changes, and the hash of the file
    that they were begun on."""

    def __init__(self, document: Document) -> None:
        self._document, self._file = document, document.opened.file
        mark = read_mark(self._file.parent)
        saved_here = self._file.name == "design.toml" and mark is not None and mark.made_by == "studio"
        self.folder = self._file.parent if saved_here else self._file.with_name(f"{self._file.stem}_studio")
        self.template_folder = self._file.with_name(f"{self._file.stem}_template")
        self.autosave = self._file.with_name(f".{self._file.name}.studio")
        self._autosaved: Layout | None = None
        self._autosaves = True  # until one fails
        self._known = content_hash(self._file)
        self._saved: dict[Path, str | None] = {}  # folder -> hash of the design last written there

    def restore(self) -> None:
        """Bring back what was unsaved: in place of the file's layout, or where redo finds it if the file is another."""
        document, design = self._document, self._document.layout.design
        try:
            content = read_json(self.autosave)
            table = Table(content, str(self.autosave))
            table.decoded = vars(design)  # whose types and cloth the muscles must fit
            muscles = decode_key(tuple[Muscle, ...], table, "muscles", ())
            pressures = tuple(float(pressure) for pressure in content["pressures_pa"])
            known, same_file = content["format"] == FORMAT, content["begun_on"] == content_hash(self._file)
        except (ValueError, KeyError, TypeError, AttributeError):  # there is none, or none that fits
            return
        restored = Layout.of(dataclasses.replace(design, muscles=muscles), pressures)
        if not known or restored == document.layout:
            return
        if same_file:
            document.history.do("restored changes", restored)
            document.tell("Unsaved changes of the last time are restored; undo takes them away.")
        else:
            document.history.offer("restored changes", restored)
            document.tell("The file has changed since the last time; redo brings the unsaved changes back.", bad=True)

    def keep(self) -> None:
        """Write what is unsaved, if anything, into the autosave."""
        history = self._document.history
        try:
            if not history.changed:
                self._clear()
            elif self._autosaves and history.layout != self._autosaved:
                layout = history.layout
                muscles = [dataclasses.asdict(muscle) for muscle in layout.design.muscles]
                content = {"format": FORMAT, "begun_on": content_hash(self._file), "muscles": muscles}
                write_json(self.autosave, content | {"pressures_pa": list(layout.pressures)})
                self._autosaved = layout
        except InputError as error:
            if self._autosaves:
                self._document.tell(f"no autosave: {error}", bad=True)
            self._autosaves = False

    def _clear(self) -> None:
        self.autosave.unlink(missing_ok=True)
        self._autosaved = None

    def follow_file(self) -> None:
        """Take the file where another program has changed it, or say so where something is unsaved."""
        before, self._known = self._known, content_hash(self._file)
        if self._known is None or self._known == before:
            return
        if not self._document.history.changed:
            self.load_again()
            return
        self._document.tell(f"{self._file.name} was changed by another program; 'Load from disk' takes it.", bad=True)

    def load_again(self) -> None:
        """Take the design as it is on disk now; undo brings back what was here. Raises InputError."""
        document, self._known = self._document, content_hash(self._file)
        try:
            design = read_design(self._file)
        except InputError as error:
            raise InputError(f"changed on disk, and not taken: {error}") from None
        document.put("load from disk", document.history.layout.on(design))
        document.history.keep()
        document.tell(f"{self._file.name} was taken from disk; undo brings back what was here.")

    def replaces(self, folder: Path) -> str | None:
        """Return why a person should be asked before `folder` is replaced; None where nothing would be lost."""
        design, key = folder / "design.toml", folder.resolve()
        if read_mark(folder) is None or not design.exists():
            return None  # nothing there, or what `new_folder` refuses anyway
        if key not in self._saved:
            return f"{folder} holds an earlier design"
        if self._saved[key] != content_hash(design):
            return f"{design} was changed by another program since it was saved"
        return None

    def save(self, folder: Path, *, replace: bool = False) -> None:
        """Save what is shown into one folder: `design.toml`, a table of pressures for each pose, with a target
        `study.toml`, and `template/`.

        replace: what stands in the folder, if this program made it. Raises InputError where that is refused.
        """
        document, layout = self._document, self._document.layout
        document.history.end()
        self._clear()  # it may lie in the folder, where no other files may be
        try:
            if (reason := self.replaces(folder)) is not None and not replace:
                raise InputError(f"{reason}; expected another folder, or leave to replace it")
            with new_folder(folder, made_by="studio", force=True) as unfinished:
                write_design(layout.design, unfinished / "design.toml")
                for pose, shown in enumerate(document.layouts if layout.pressures else (), start=1):
                    program = rising_program(regulated(np.array(shown.pressures)), RISE, RISE + SETTLED)
                    write_pressures(program, unfinished / pressure_file_of(pose))
                if document.targets:
                    text = study_document(
                        layout, document.targets, document.limits, vary="pressures and positions", seconds=600,
                        model=document.model_file, beside=folder,
                    )  # fmt: skip
                    write_text(unfinished / "study.toml", text)
                left_out: tuple[str, ...] = ("no template: the design has no muscles",)
                if layout.design.muscles:
                    try:
                        left_out = _export(layout, unfinished / "template", replace=False).left_out
                    except InputError as error:
                        left_out = (f"no template: {error}",)
                count = sum(file.is_file() and not file.name.startswith(".") for file in unfinished.rglob("*"))
        except InputError:
            self.keep()
            raise
        self.folder = folder
        self._saved[folder.resolve()] = content_hash(folder / "design.toml")
        if document.shown is None:
            document.history.keep()
        if (folder / "design.toml").resolve() == self._file.resolve():
            self._known = content_hash(self._file)
        document.tell("; ".join([f"saved {count} files in {folder}", *left_out]))

    def save_template(self, folder: Path, *, replace: bool = False) -> None:
        """Write the sewing template of what is shown, and say so."""
        saved = _export(self._document.layout, folder, replace=replace)
        names = ", ".join(file.name for file in saved.files)
        self._document.tell("; ".join([f"sewing template in {folder}: {names}", *saved.left_out]))


def _export(layout: Layout, folder: Path, *, replace: bool) -> Exported:
    """Write what `fabdesign export` does into a folder. Raises InputError like it."""
    kinds = [layout.design.muscle_types[muscle.type] for muscle in layout.design.muscles]
    tail = _TAIL if any(kind.tail_length is None for kind in kinds) else None
    return export_design(layout.design, folder, Sewing(tail_length=tail), stem="design", force=replace)


class Session:
    """The document, shapes from the simulator, motions, errors of trials, a search, files."""

    def __init__(self, opened: Opened, solver: Any, *, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.document = Document(opened, clock)
        self.shapes = Shapes(self.document, solver)
        self.playing = Playing(self.document, self.shapes)
        moving = opened.moving
        self.program = None if moving is None else ProgramEdit(moving, self.document, self.shapes, self.playing)
        self.files = Files(self.document)
        self.search = BackgroundSearch(self.document, lambda: self.files.folder)
        self._looked = clock()

    def begin(self, show: Callable[[], None]) -> None:
        """Restore what was unsaved, and ask for the first shape. show: draws the page, whenever something changes."""
        self.document.show = show
        self.files.restore()
        self.document.changed()
        if self.program is not None:
            self.program.play()

    def tick(self) -> None:
        """Do whatever is due: shapes, the end of a gesture, autosave, the file, a search."""
        self.document.end_gesture(CALM)
        self.shapes.turn()
        if self._clock() - self._looked > DUE:
            self._looked = self._clock()
            self.files.keep()
            self.files.follow_file()
            self.search.follow()

    def end(self) -> None:
        """Leave: unsaved changes stay in the autosave, a search ends with its best."""
        self.document.history.end()
        self.files.keep()
        self.search.close()
