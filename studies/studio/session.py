"""One sitting: the document and what follows from it. One thread owns it, the page asks through a queue."""

import time
from collections.abc import Callable
from typing import Any

from studies.studio.document import Document
from studies.studio.files import Files
from studies.studio.opening import Opened
from studies.studio.playing import Playing, ProgramEdit
from studies.studio.search import BackgroundSearch
from studies.studio.shapes import Shapes

CALM = 0.35  # s without a further value, after which a slider counts as let go
DUE = 1.0  # s between autosaves, and looks at the file and the search


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
