"""The studio as a server: the page behind its gate, the simulator beside it, and the one loop that owns the session."""

import contextlib
import io
import queue
import tempfile
import time
import traceback
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fabdesign.errors import InputError
from studies.studio.gate import Gate
from studies.studio.opening import Opened
from studies.studio.session import Session
from studies.studio.solver import SolverProcess
from studies.studio.widgets.page import Page

_BEAT = 0.02  # s between looks at what is due
_SHORT = 0.002  # s, while an answer of the simulator is awaited


def serve(
    opened: Opened,
    *,
    host: str = "127.0.0.1",
    port: int | None = None,
    announce: Callable[[str], None],
    browser: bool = False,
    make_worker: Callable[[], Any] = SolverProcess,
) -> None:
    """Run until it is interrupted. announce: is told the address once the page can be opened. port: None takes the
    first free one. Raises InputError where it cannot listen; unsaved changes lie in the autosave whatever ends it."""
    with contextlib.closing(Gate(host, port)) as gate, quiet_viser(gate) as viser_server:
        announce(gate.address)
        with contextlib.closing(make_worker()) as worker, contextlib.ExitStack() as stack:
            studio = Studio(viser_server, opened, worker)
            if browser:
                stack.enter_context(tab_at(gate.address))
            try:
                studio.run()
            finally:
                studio.session.end()


class Studio:
    """Page and session, and the queue through which the page's threads reach the session's."""

    def __init__(self, viser_server: Any, opened: Opened, worker: Any) -> None:
        self._due: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._worker = worker
        self.session = Session(opened, worker)
        self.page = Page(viser_server, self.session, self.post)
        self._stale = False  # whether the page shows what no longer holds

    def post(self, ask: Callable[[], None]) -> None:
        """Have something done on the session's thread, by the next turn."""
        self._due.put(ask)

    def begin(self) -> None:
        def changed() -> None:
            self._stale = True

        self.session.begin(changed)

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        self.begin()
        last, alive = time.monotonic(), True
        while not until():
            self.turn()
            now = time.monotonic()
            self.session.playing.advance(now - last)
            last = now
            if alive and not self._worker.alive:
                alive = False
                self.session.document.tell("The simulator has ended; save, and start the studio again.", bad=True)

    def turn(self) -> None:
        """Do what the page asks, all that has come, or after a beat nothing; then what is due; draw what changed."""
        with contextlib.suppress(queue.Empty):
            ask = self._due.get(timeout=_SHORT if self.session.shapes.waiting else _BEAT)
            while True:
                self._do(ask)
                ask = self._due.get_nowait()
        self.session.tick()
        if self._stale:
            self._do(self.page.show)
            self._stale = False  # also where that failed: it would fail again

    def _do(self, ask: Callable[[], None]) -> None:
        """Do one thing; an error in it must not take the layout along."""
        tell = self.session.document.tell
        try:
            ask()
        except InputError as error:
            tell(str(error), bad=True)
        except Exception as error:
            traceback.print_exc()
            tell(f"an error of the program: {type(error).__name__}: {error}", bad=True)


@contextmanager
def tab_at(address: str) -> Iterator[None]:
    """Have the browser open an address, by a file that only this user can read: every user of a machine can read the
    command lines of its processes, and the address lets in."""
    with contextlib.ExitStack() as stack:
        try:
            # a browser in a box of its own (snap) sees no other folder than the home
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="fabdesign_studio_", dir=Path.home()))
        except (OSError, RuntimeError):
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="fabdesign_studio_"))
        file = Path(folder) / "open.html"
        file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">')
        webbrowser.open(file.as_uri())
        yield


@contextmanager
def quiet_viser(gate: Gate) -> Iterator[Any]:
    """Run viser behind a gate, silent, and unable to give itself a public address."""
    import rich
    import viser

    class Server(viser.ViserServer):
        def request_share_url(self, verbose: bool = True) -> str | None:
            """Refuse to share: a design is the laboratory's."""
            return None

    rich.reconfigure(quiet=True)
    with contextlib.redirect_stdout(io.StringIO()), gate.before():
        server = Server(host="127.0.0.1", port=gate.port, label="fabdesign studio", verbose=False)
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
