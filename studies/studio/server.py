"""The studio as a server: the page behind its gate, and the simulator beside it."""

import contextlib
import io
import tempfile
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from studies.studio.gate import Gate
from studies.studio.opening import Opened
from studies.studio.solver import SolverProcess
from studies.studio.widgets.page import Page


def serve(
    opened: Opened,
    *,
    host: str = "127.0.0.1",
    port: int | None = None,
    announce: Callable[[str], None],
    browser: bool = False,
) -> None:
    """Run until it is interrupted. announce: is told the address once the page can be opened. port: None takes the
    first free one. Raises InputError where it cannot listen; unsaved changes lie in the autosave whatever ends it."""
    with contextlib.closing(Gate(host, port)) as gate, quiet_viser(gate) as viser_server:
        announce(gate.address)
        with contextlib.closing(SolverProcess()) as worker, contextlib.ExitStack() as stack:
            page = Page(viser_server, opened, worker)
            if browser:
                stack.enter_context(tab_at(gate.address))
            stack.callback(page.session.end)
            page.run()


@contextmanager
def tab_at(address: str) -> Iterator[None]:
    """Have the browser open an address, by a file that only this user can read: every user of a machine can read the
    command lines of its processes, and the address lets in."""
    try:  # a browser in a box of its own (snap) sees no other folder than the home
        folder = tempfile.TemporaryDirectory(prefix="fabdesign_studio_", dir=Path.home())
    except (OSError, RuntimeError):
        folder = tempfile.TemporaryDirectory(prefix="fabdesign_studio_")
    with folder as name:
        file = Path(name) / "open.html"
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
