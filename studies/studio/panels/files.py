"""Saving into a folder, and taking the design from disk again."""

from pathlib import Path
from typing import Any

from studies.studio.panels.asking import Post, on_click, put
from studies.studio.session import Session


class FilePanel:
    def __init__(self, gui: Any, session: Session, post: Post) -> None:
        self._gui, self._session, self._post = gui, session, post
        self._folder = gui.add_text("Folder", str(session.files.folder))
        on_click(gui.add_button("Save"), post, self._save)
        on_click(gui.add_button("Load from disk"), post, session.files.load_again)
        self._text = gui.add_markdown("")
        self.show()

    def show(self) -> None:
        session = self._session
        state = "unsaved changes, kept in an autosave" if session.document.changed else "nothing unsaved"
        undo = f"; undo: {session.document.next_undo}" if session.document.next_undo else ""
        self._text.content = f"`{session.opened.file}`: {state}{undo}"

    def _save(self) -> None:
        folder = Path(self._folder.value.strip())
        reason = self._session.files.would_replace(folder)
        if reason is None:
            self._session.files.save(folder)
            put(self._folder, str(self._session.files.folder))
            return
        dialog = self._gui.add_modal("Replace what is there?")
        with dialog:
            self._gui.add_markdown(f"{reason}.")
            yes = self._gui.add_button("Replace it")
            no = self._gui.add_button("Leave it")

        def replace() -> None:
            dialog.close()
            self._session.files.save(folder, replace=True)

        on_click(yes, self._post, replace)
        on_click(no, self._post, dialog.close)
