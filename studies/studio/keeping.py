"""What of a sitting lies on disk: the autosave, the file that was opened, and the folder that it is saved in."""

from pathlib import Path
from typing import TYPE_CHECKING

from fabdesign.errors import InputError
from fabdesign.output import read_mark
from studies.studio.autosave import Autosave, Watched
from studies.studio.layout import Layout
from studies.studio.opening import Opened
from studies.studio.saving import Saved, Saving, save_template

if TYPE_CHECKING:
    from studies.studio.session import Session


class Keeping:
    """folder: where it is saved unless another place is typed."""

    def __init__(self, session: "Session") -> None:
        self._session = session
        self.folder = _folder(session.opened)
        self._saving, self._autosave = Saving(), Autosave(session.opened.file)
        self._autosaves = True  # until one fails
        self._watched = Watched(session.opened.file)

    def restore(self) -> None:
        """What was left unsaved: in place of the file's layout, or where redo finds it if the file is another."""
        session = self._session
        left = self._autosave.read(session.layout.design)
        if left is None or left[0] == session.layout:
            return
        layout, same_file = left
        if same_file:
            session.document.do("restored changes", layout)
            session.view.tell("Unsaved changes of the last time are restored; undo takes them away.")
        else:
            session.document.offer("restored changes", layout)
            session.view.tell(
                "The file has changed since the last time; redo brings the unsaved changes back.", bad=True
            )

    def keep(self) -> None:
        """Write what is unsaved, if anything, into the autosave."""
        document = self._session.document
        try:
            if document.changed and self._autosaves:
                self._autosave.write(document.layout)
            elif not document.changed:
                self._autosave.clear()
        except InputError as error:
            if self._autosaves:
                self._session.view.tell(f"no autosave: {error}", bad=True)
            self._autosaves = False

    def follow_file(self) -> None:
        """Another program may have changed it."""
        if not self._watched.changed():
            return
        if self._session.document.changed:
            name = self._session.opened.file.name
            self._session.view.tell(f"{name} was changed by another program; 'Load from disk' takes it.", bad=True)
            return
        self.load_again()

    def load_again(self) -> None:
        """Take the design as it is on disk now; undo brings back what was here."""
        session = self._session
        try:
            design = self._watched.read()
        except InputError as error:
            session.view.tell(f"changed on disk, and not taken: {error}", bad=True)
            return
        session.drawings.shown = None
        session.document.do("load from disk", Layout.of(design, session.document.layout.pressures))
        session.document.keep()
        session.changed()
        session.view.tell(f"{session.opened.file.name} was taken from disk; undo brings back what was here.")

    def save(self, folder: Path, *, replace: bool = False) -> Saved | None:
        """What was written; None where it was not, and was told."""
        session = self._session
        session.document.end()
        self._autosave.clear()  # it may lie in the folder, where no other files may be
        try:
            saved = self._saving.save(
                session.layout, folder, targets=session.targets.all, poses=session.targets.pressures,
                limits=session.limits, model=session.model_file, replace=replace,
            )  # fmt: skip
        except InputError as error:
            self.keep()
            session.view.tell(str(error), bad=True)
            return None
        self.folder = folder
        if session.drawings.shown is None:
            session.document.keep()
        if (folder / "design.toml").resolve() == session.opened.file.resolve():
            self._watched.seen()
        session.view.tell("; ".join([f"saved {len(saved.files)} files in {folder}", *saved.left_out]))
        session.view.show_layout()
        return saved

    def would_replace(self, folder: Path) -> str | None:
        return self._saving.replaces(folder)

    @property
    def template_folder(self) -> Path:
        """Where templates go unless another place is typed."""
        return self._session.opened.file.with_name(f"{self._session.opened.file.stem}_template")

    def save_template(self, folder: Path, *, replace: bool = False) -> None:
        """Write the sewing template of what is shown, and say so."""
        try:
            saved = save_template(self._session.layout, folder, replace=replace)
        except InputError as error:
            self._session.view.tell(str(error), bad=True)
            return
        names = ", ".join(file.name for file in saved.files)
        self._session.view.tell("; ".join([f"sewing template in {folder}: {names}", *saved.left_out]))


def _folder(opened: Opened) -> Path:
    """The folder of a design that was saved like that, else a new one beside the file."""
    mark = read_mark(opened.file.parent)
    if opened.file.name == "design.toml" and mark is not None and mark.made_by == "studio":
        return opened.file.parent
    return opened.file.with_name(f"{opened.file.stem}_studio")
