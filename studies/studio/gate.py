"""The door of the page: every connection shows a token, or comes from this machine's own page, before it is let in.

Any web page in a browser may open a connection to 127.0.0.1, and viser asks nobody who they are. So viser listens on a
port that nobody is told, and this one passes on what may come in.
"""

import asyncio
import contextlib
import secrets
import threading
from urllib.parse import parse_qs, urlsplit

from fabdesign.errors import InputError

LOCAL = ("127.0.0.1", "localhost", "::1")
_COOKIE = "fabdesign_studio"
_HEAD = 64 * 1024  # bytes, the most of a request's head


class Gate:
    """Listens on host and port and passes on to `inner`, a port of this machine. Where `host` is not this machine's
    own address a token is asked for; `address` has it."""

    def __init__(self, host: str, port: int | None, inner: int, *, first: int = 8080) -> None:
        """port: None for the first free one from `first` on. Raises InputError where it cannot listen."""
        self.token = None if host in LOCAL else secrets.token_urlsafe(24)
        self._host, self._inner = host, inner
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True, name="studio gate")
        self._thread.start()
        wanted = range(first, first + 100) if port is None else [port]
        self._server, self.port = self._listen(list(wanted), given=port is not None)

    @property
    def address(self) -> str:
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"http://{host}:{self.port}/" + ("" if self.token is None else f"?token={self.token}")

    def close(self) -> None:
        async def end() -> None:
            self._server.close()
            for task in asyncio.all_tasks() - {asyncio.current_task()}:
                task.cancel()

        with contextlib.suppress(Exception):
            asyncio.run_coroutine_threadsafe(end(), self._loop).result(2.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(2.0)

    def _listen(self, ports: list[int], *, given: bool) -> tuple[asyncio.Server, int]:
        problem: OSError | None = None
        for port in ports:
            listening = asyncio.start_server(self._admit, self._host, port, limit=_HEAD)
            try:
                server = asyncio.run_coroutine_threadsafe(listening, self._loop).result()
            except OSError as error:
                problem = error
                continue
            return server, int(server.sockets[0].getsockname()[1])
        self._loop.call_soon_threadsafe(self._loop.stop)
        reason = (problem.strerror or str(problem)) if problem else "no port"
        if given:
            raise InputError(f"--port {ports[0]} on {self._host}: {reason}; expected a free port of this machine")
        raise InputError(f"--host {self._host}: {reason}; expected an address of this machine")

    # a connection that breaks, or is cut when the gate closes, is nobody's fault
    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(
            OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, asyncio.CancelledError
        ):
            head = await reader.readuntil(b"\r\n\r\n")
            refusal = self.refusal(head)
            if refusal is not None:
                writer.write(refusal)
                await writer.drain()
            else:
                to, goal = await asyncio.open_connection("127.0.0.1", self._inner)
                goal.write(head)
                await asyncio.gather(_pass(reader, goal), _pass(to, writer))
        writer.close()

    def refusal(self, head: bytes) -> bytes | None:
        """What is answered to a request that is not passed on, as it stands or with the token taken from it."""
        line, *rest = head.decode("latin-1").split("\r\n")
        headers = {name.lower(): value.strip() for name, _, value in (entry.partition(":") for entry in rest)}
        path = (line.split(" ") + [""])[1]
        origin, host = headers.get("origin"), headers.get("host", "")
        if origin is not None and urlsplit(origin).netloc != host:
            return _answer("403 Forbidden", "This page is for its own tab only.")
        if self.token is None:
            local = urlsplit(f"//{host}").hostname in LOCAL
            return None if local else _answer("403 Forbidden", "Open the page by the address that was printed.")
        cookies = [entry.strip() for entry in headers.get("cookie", "").split(";")]
        if any(secrets.compare_digest(entry.encode(), f"{_COOKIE}={self.token}".encode()) for entry in cookies):
            return None
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        if secrets.compare_digest(given.encode(), self.token.encode()):
            cookie = f"Set-Cookie: {_COOKIE}={self.token}; HttpOnly; SameSite=Lax; Path=/\r\nLocation: /\r\n"
            return _answer("303 See Other", "", cookie)
        return _answer("403 Forbidden", "A token is missing: open the page by the address that was printed.")


def _answer(status: str, text: str, headers: str = "") -> bytes:
    body = f"{text}\n".encode()
    lines = f"HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {len(body)}\r\n"
    return f"{lines}{headers}Connection: close\r\n\r\n".encode() + body


async def _pass(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
    finally:
        writer.close()
