"""Saving into a folder, the sewing template, and taking the design from disk again."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from fabdesign.output import read_mark
from studies.studio.panels.asking import Post, markdown, on_click, put
from studies.studio.session import Session


class FilePanel:
    def __init__(self, gui: Any, session: Session, post: Post) -> None:
        self._gui, self._session, self._post = gui, session, post
        self._folder = gui.add_text("Folder", str(session.files.folder))
        on_click(gui.add_button("Save"), post, self._save)
        on_click(gui.add_button("Load from disk"), post, session.files.load_again)
        self._text = gui.add_markdown("")
        with gui.add_folder("Sewing template, 1:1"):
            self._template = gui.add_text("Folder", str(session.files.template_folder))
            on_click(gui.add_button("Export template"), post, self._export)
        self.show()

    def show(self) -> None:
        session = self._session
        state = "unsaved changes, kept in an autosave" if session.document.changed else "nothing unsaved"
        undo = f"; undo: {session.document.next_undo}" if session.document.next_undo else ""
        self._text.content = markdown(f"`{session.opened.file}`: {state}{undo}")

    def _save(self) -> None:
        folder = Path(self._folder.value.strip())

        def save(*, replace: bool) -> None:
            if self._session.files.save(folder, replace=replace) is not None:
                put(self._folder, str(folder))

        self._unless_lost(self._session.files.would_replace(folder), save)

    def _export(self) -> None:
        folder = Path(self._template.value.strip())
        mark = read_mark(folder)
        reason = None if mark is None else f"{folder} holds what `fabdesign {mark.made_by}` wrote"
        self._unless_lost(reason, partial(self._session.files.save_template, folder))

    def _unless_lost(self, reason: str | None, write: Callable[..., Any]) -> None:
        """Write, after asking where something would be lost by it."""
        if reason is None:
            write(replace=False)
            return
        dialog = self._gui.add_modal("Replace what is there?")
        with dialog:
            self._gui.add_markdown(markdown(f"{reason}."))
            yes = self._gui.add_button("Replace it")
            no = self._gui.add_button("Leave it")

        def replace() -> None:
            dialog.close()
            write(replace=True)

        on_click(yes, self._post, replace)
        on_click(no, self._post, dialog.close)
