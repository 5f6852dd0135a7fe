"""The studio as a server: the simulator beside the page, and the gate before it: no request reaches viser that does
not show the secret of this session.

Any web page in a browser, and any user of this machine, may connect to a port of 127.0.0.1, and viser asks nobody who
they are. So viser gets no port of its own: it listens on the gate's, and the gate sees each request first, those that
open a websocket too.

The printed address has a token. Whoever shows it gets a cookie, and goes on by that. A browser sends a cookie to every
port of a host, so to other users' servers on this machine too; therefore the cookie is bound to a path that nobody
can guess. The token stands in no header, no log and no command line of a process.
"""

import contextlib
import io
import ipaddress
import logging
import secrets
import socket
import tempfile
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from fabdesign.errors import InputError
from studies.studio.opening import Opened
from studies.studio.solver import SolverProcess
from studies.studio.widgets.page import Page

if TYPE_CHECKING:
    from websockets.http11 import Request, Response

_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",  # no other page shows this one and has it clicked
    "Referrer-Policy": "no-referrer",
}


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
def quiet_viser(gate: "Gate") -> Iterator[Any]:
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


class Gate:
    """Listens on a host and a port, and lets in whoever shows the secret. `address` has it."""

    def __init__(self, host: str, port: int | None, *, first: int = 8080) -> None:
        """Listen on a port. port: None for the first free one from `first` on. Raises InputError where it cannot
        listen."""
        self._socket = _listening(host, port, first)
        bound, self.port = self._socket.getsockname()[:2]
        # "localhost" may lead elsewhere too, where another user listens
        self._local = _is_local(bound)
        self._host = bound if self._local else host
        self.token = secrets.token_urlsafe(24)
        self._cookie = f"fabdesign_studio={secrets.token_urlsafe(24)}"
        self._folder = f"/{secrets.token_urlsafe(12)}"

    @property
    def address(self) -> str:
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self.port}/?token={self.token}"

    def close(self) -> None:
        self._socket.close()

    @contextmanager
    def before(self) -> Iterator[None]:
        """Have the one server that websockets starts meanwhile listen here, and nowhere else. Raises RuntimeError
        where none was started."""
        import websockets.asyncio.server as servers

        # requests stay here: their paths may hold a token, and what is no request at all is no error of this program
        logger = logging.getLogger("fabdesign.studio")
        logger.setLevel(logging.ERROR)
        logger.addFilter(lambda record: "handshake" not in record.getMessage())
        serve, started = servers.serve, []

        def behind_gate(handler: Any, _host: Any, _port: Any, *, process_request: Any, **options: Any) -> Any:
            def request_first(connection: Any, request: "Request") -> "Response | None":
                return self.answer(request, lambda passed: process_request(connection, passed))

            started.append(handler)
            return serve(handler, sock=self._socket, process_request=request_first, logger=logger, **options)

        servers.serve = behind_gate  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            servers.serve = serve  # type: ignore[misc]
        if len(started) != 1:
            raise RuntimeError(f"viser started {len(started)} servers behind the gate; expected 1")

    def answer(self, request: "Request", then: Callable[["Request"], "Response | None"]) -> "Response | None":
        """Return the response to a request, by `then` where it is let in; None opens a websocket."""
        response = self._refusal(request)
        if response is None:
            try:
                from websockets.http11 import Request

                # as viser knows it, without the folder
                response = then(Request(request.path.removeprefix(self._folder) or "/", request.headers))
            except (OSError, ValueError):  # a path that no file can have: too long, with a zero byte
                response = _response(HTTPStatus.NOT_FOUND, "There is no such file.")
        if response is not None:
            response.headers.update(_HEADERS)
        return response

    def _refusal(self, request: "Request") -> "Response | None":
        """Return what is answered to a request that is not passed on."""
        try:
            host, origin, upgrade = (_single(request, name) for name in ("Host", "Origin", "Upgrade"))
            name = urlsplit(f"//{host}").hostname
            foreign = origin is not None and urlsplit(origin).netloc != host
        except ValueError:
            return _response(HTTPStatus.BAD_REQUEST, "Host or Origin cannot be read.")
        if host is None:
            return _response(HTTPStatus.BAD_REQUEST, "Host is missing.")
        if foreign:
            return _response(HTTPStatus.FORBIDDEN, "This page is for its own tab only.")
        if self._local and not _is_local(name or ""):  # a foreign name that was made to lead here
            return _response(HTTPStatus.FORBIDDEN, "Open the page by the address that was printed.")
        cookies = "; ".join(request.headers.get_all("Cookie")).split("; ")
        if any(_same(cookie, self._cookie) for cookie in cookies):
            return None
        given = parse_qs(request.path.partition("?")[2]).get("token", [""])[0]
        if not _same(given, self.token):
            return _response(HTTPStatus.FORBIDDEN, "A token is missing: open the page by the address that was printed.")
        return None if upgrade is not None else self._let_in()

    def _let_in(self) -> "Response":
        """Return a page that gives the cookie and leads on. A redirect would count as coming from wherever the address
        was clicked, and a browser keeps strict cookies back then."""
        page = f'<!doctype html><title>fabdesign</title><meta http-equiv="refresh" content="0; url={self._folder}/">'
        response = _response(HTTPStatus.OK, page, "text/html")
        response.headers["Set-Cookie"] = f"{self._cookie}; Path={self._folder}; HttpOnly; SameSite=Strict"
        return response


def _listening(host: str, port: int | None, first: int) -> socket.socket:
    try:
        family, *_, address = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"--host {host}: {reason}; expected an address of this machine") from None
    for number in range(first, first + 100) if port is None else (port,):
        try:
            return socket.create_server((address[0], number, *address[2:]), family=family)
        except OSError as error:
            reason = error.strerror or str(error)
    which = (f"--host {host}", "an address") if port is None else (f"--port {port} on {host}", "a free port")
    raise InputError(f"{which[0]}: {reason}; expected {which[1]} of this machine")


def _is_local(name: str) -> bool:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(name).is_loopback
    return name == "localhost"


def _single(request: "Request", name: str) -> str | None:
    """Return a header's value. Raises ValueError where it came twice: two programs may read it in two ways."""
    values = request.headers.get_all(name)
    if len(values) > 1:
        raise ValueError(name)
    return values[0] if values else None


def _same(given: str, secret: str) -> bool:
    return secrets.compare_digest(given.encode(errors="replace"), secret.encode())


def _response(status: HTTPStatus, text: str, kind: str = "text/plain") -> "Response":
    from websockets.datastructures import Headers
    from websockets.http11 import Response

    body = f"{text}\n".encode()
    headers = Headers(
        {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body)), "Connection": "close"}
    )
    return Response(status.value, status.phrase, headers, body)
