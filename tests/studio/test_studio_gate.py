"""Who comes into the studio: nobody without the secret, by no port, and whoever has the printed address."""

import contextlib
import http.server
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.nouns.catalogue import build
from studies.studio.server import Gate, quiet_viser, tab_at
from tests.browser import browser_at, chromium
from tests.conftest import ROOT
from tests.interrupted import descendants

viser = pytest.importorskip("viser", reason="no viser: pip install 'fabdesign[studio]'")
websockets = pytest.importorskip("websockets")
in_proc = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="processes are looked up in /proc")


@pytest.fixture(scope="module")
def gate() -> Iterator[Gate]:
    """A gate with viser behind it."""
    with contextlib.closing(Gate("127.0.0.1", None, first=18431)) as gate, quiet_viser(gate):
        yield gate


def request(port: int, head: str) -> str:
    """Return the response to a request, as it is sent."""
    with socket.create_connection(("127.0.0.1", port), timeout=5) as connection:
        connection.sendall(head.replace("\n", "\r\n").encode("utf-8", "surrogateescape") + b"\r\n\r\n")
        parts = iter(lambda: connection.recv(1 << 16), b"")
        return b"".join(parts).decode("utf-8", "replace")


def status(port: int, path: str = "/", **headers: str) -> int:
    """Return the status of a request with these headers, besides Host."""
    lines = "".join(f"\n{name}: {value}" for name, value in ({"Host": f"127.0.0.1:{port}"} | headers).items())
    return int(request(port, f"GET {path} HTTP/1.1{lines}").split(" ")[1])


def cookie_of(gate: Gate) -> tuple[str, str]:
    """Return the cookie that the token is traded for, and the path that it is bound to."""
    answer = request(gate.port, f"GET /?token={gate.token} HTTP/1.1\nHost: 127.0.0.1:{gate.port}")
    assert answer.startswith("HTTP/1.1 200")
    line = next(line for line in answer.splitlines() if line.startswith("Set-Cookie: "))
    cookie, path, *rest = line.removeprefix("Set-Cookie: ").split("; ")
    assert rest == ["HttpOnly", "SameSite=Strict"]
    path = path.removeprefix("Path=")
    assert f"url={path}/" in answer
    return cookie, path


def websocket_opens(address: str, origin: str | None = None, **headers: str) -> bool:
    """Whether viser says something to a websocket; False where the handshake is refused."""
    from websockets.sync.client import connect

    with contextlib.suppress(websockets.exceptions.InvalidHandshake):
        opened = connect(
            address,
            origin=origin,
            subprotocols=[f"viser-v{viser.__version__}"],
            additional_headers=headers,
            proxy=None,
            open_timeout=5,
        )
        with opened as connection:
            return len(connection.recv(timeout=5)) > 0
    return False


def test_the_address_lets_in_and_nothing_else_does(gate: Gate) -> None:
    port, gate_origin = gate.port, f"http://127.0.0.1:{gate.port}"
    assert gate.address == f"{gate_origin}/?token={gate.token}"
    assert [status(port, path) for path in ("/", "/?token=wrong", "/?token=", "/?token=%ff", "/?token=\udcff")] == [
        403
    ] * 5
    cookie, path = cookie_of(gate)
    assert path != "/"  # else a browser would send the cookie to each port of this machine
    page = request(port, f"GET {path} HTTP/1.1\nHost: 127.0.0.1:{port}\nCookie: other=1; {cookie}")
    assert page.startswith("HTTP/1.1 200")
    assert "<title>Viser</title>" in page
    assert "\r\nReferrer-Policy: no-referrer\r\n" in page
    assert "frame-ancestors 'none'" in page
    assert status(port, path) == 403
    assert status(port, path, Cookie=f"{cookie}x") == 403
    assert status(port, f"{path}/", Cookie=cookie, Origin=gate_origin) == 200
    assert status(port, path, Cookie=cookie, Origin="http://evil.example") == 403
    assert status(port, path, Cookie=cookie, Origin=f"http://127.0.0.1:{port + 1}") == 403  # another user's page
    assert status(port, path, Cookie=cookie, Host="evil.example") == 403  # a name that was made to lead here
    assert status(port, path, Cookie=cookie, Host=f"localhost:{port}") == 200  # through a tunnel


def test_what_cannot_be_read_is_a_400(gate: Gate, capfd: pytest.CaptureFixture[str]) -> None:
    port, (cookie, _) = gate.port, cookie_of(gate)
    for secret in ({}, {"Cookie": cookie}):
        assert status(port, Host="[::1", **secret) == 400
        assert status(port, Origin="http://[", **secret) == 400
        assert status(port, Host=f"127.0.0.1:{port}\nHost: evil.example", **secret) == 400
        assert status(port, Origin=f"http://127.0.0.1:{port}\nOrigin: http://evil.example", **secret) == 400
    assert request(port, "GET / HTTP/1.1").startswith("HTTP/1.1 400")  # no Host
    for path in ("//[?token=", f"/{'a' * 5000}", f"/{'a/' * 3000}", "/a%00b", "/a\0b"):
        assert status(port, path, Cookie=cookie) == 404
    assert request(port, "\x16\x03\x01") == ""  # no request at all
    assert capfd.readouterr() == ("", "")


def test_a_websocket_needs_the_secret(gate: Gate) -> None:
    cookie, path = cookie_of(gate)
    gate_origin, address = f"http://127.0.0.1:{gate.port}", f"ws://127.0.0.1:{gate.port}"
    for origin in (None, gate_origin, "http://evil.example", "null"):
        assert not websocket_opens(f"{address}/", origin)
        assert not websocket_opens(f"{address}{path}", origin)
        assert not websocket_opens(f"{address}/?token=wrong", origin)
    assert not websocket_opens(f"{address}{path}", "http://evil.example", Cookie=cookie)
    assert not websocket_opens(f"{address}{path}", "null", Cookie=cookie)
    assert websocket_opens(f"{address}{path}", gate_origin, Cookie=cookie)
    assert websocket_opens(f"{address}/?token={gate.token}")


def test_where_it_listens() -> None:
    with contextlib.closing(Gate("127.0.0.1", None, first=18431)) as gate:
        with pytest.raises(InputError, match="expected a free port"):
            Gate("127.0.0.1", gate.port)
        with contextlib.closing(Gate("127.0.0.1", None, first=gate.port)) as other:
            assert other.port != gate.port
            assert other.token != gate.token
    with pytest.raises(InputError, match=r"--host 192\.0\.2\.1: .*; expected an address of this machine"):
        Gate("192.0.2.1", None)
    with pytest.raises(InputError, match=r"--host no such: .*; expected an address of this machine"):
        Gate("no such", None)
    with contextlib.closing(Gate("localhost", None)) as named:
        assert urlsplit(named.address).hostname in ("127.0.0.1", "::1")  # not another user's "localhost"


def test_another_host_lets_in_by_any_name() -> None:
    with contextlib.closing(Gate("0.0.0.0", None, first=18431)) as gate, quiet_viser(gate):
        assert gate.address == f"http://0.0.0.0:{gate.port}/?token={gate.token}"
        cookie, path = cookie_of(gate)
        assert status(gate.port, path, Host="somewhere") == 403
        assert status(gate.port, path, Host="somewhere", Cookie=cookie) == 200


def test_a_server_that_asks_no_gate_is_an_error() -> None:
    gate = Gate("127.0.0.1", None, first=18431)
    with contextlib.closing(gate), pytest.raises(RuntimeError, match="0 servers behind the gate"), gate.before():
        pass


def test_the_browser_is_not_told_the_token_by_its_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    with tab_at("http://127.0.0.1:8080/?token=secret"):
        (file,) = tmp_path.glob("*/*.html")
        assert opened == [file.as_uri()]
        assert "url=http://127.0.0.1:8080/?token=secret" in file.read_text()
        assert file.parent.stat().st_mode & 0o777 == 0o700
    assert not [*tmp_path.iterdir()]


@pytest.mark.skipif(chromium() is None, reason="no chromium: apt install chromium")
def test_a_browser_comes_in_and_gives_the_cookie_to_no_other_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[str, str | None]] = []

    class Foreign(http.server.BaseHTTPRequestHandler):
        """Another user's page on this machine."""

        def do_GET(self) -> None:
            seen.append((self.path, self.headers["Cookie"]))
            self.send_response(200)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None: ...

    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    with (
        contextlib.closing(Gate("127.0.0.1", None, first=18431)) as gate,
        quiet_viser(gate) as viser_server,
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), Foreign) as foreign,
        tab_at(gate.address),
        browser_at(opened[0], tmp_path / "profile", width=600, height=400, frugal=True) as page,
    ):
        threading.Thread(target=foreign.serve_forever, daemon=True).start()
        viser_server.gui.add_markdown("viser speaks")
        page.wait("document.body && document.body.innerText.includes('viser speaks')", seconds=120)
        inside = page.run("location.href")
        assert gate.token not in inside
        page.call("Page.navigate", url=f"http://127.0.0.1:{foreign.server_port}/")
        page.wait(f"location.port == {foreign.server_port} && document.readyState == 'complete'", seconds=60)
        for address in (f"http://127.0.0.1:{gate.port}/", inside):  # even if it knew where the page is
            socket = f"new WebSocket('{address}'.replace('http', 'ws'), 'viser-v{viser.__version__}')"
            ends = "socket.onopen = () => end('open'); socket.onerror = () => end('refused')"
            assert page.run(f"new Promise(end => {{const socket = {socket}; {ends}}})") == "refused"
        assert seen[0] == ("/", None)
        assert not [cookie for _, cookie in seen if cookie]
        foreign.shutdown()


@contextlib.contextmanager
def studio_program(folder: Path, *options: str) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """Run `fabdesign studio` on a design in a folder, with its address."""
    write_design(build("basic"), folder / "basic.toml")
    command = [sys.executable, "-m", "fabdesign", "studio", "basic.toml", "--no-browser", *options]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # one that ignores it is inherited
    try:
        with subprocess.Popen(
            command, cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        ) as program:  # fmt: skip
            try:
                assert program.stdout is not None
                yield program, program.stdout.readline().strip()
            finally:
                program.kill()  # else a failure would wait for it
    finally:
        signal.signal(signal.SIGINT, before)


@in_proc
@pytest.mark.parametrize("options", [(), ("--host", "0.0.0.0")])
def test_no_port_of_the_program_lets_in(tmp_path: Path, options: tuple[str, ...]) -> None:
    with studio_program(tmp_path, *options) as (program, address):
        parts = urlsplit(address)
        assert parts.query.startswith("token=")
        end = time.monotonic() + 120
        while not any("taichi" in maps_of(child) for child in tree(program.pid)[1:]):  # the simulator's process
            assert time.monotonic() < end
            time.sleep(0.1)
        ports = listening(tree(program.pid))
        assert parts.port in ports
        for port in ports:
            for origin in (None, "http://evil.example", f"http://127.0.0.1:{port}"):
                assert not websocket_opens(f"ws://127.0.0.1:{port}/", origin), (port, origin)
                assert status(port, **({} if origin is None else {"Origin": origin})) == 403
            command = Path(f"/proc/{program.pid}/cmdline").read_bytes()
            assert parts.query.removeprefix("token=").encode() not in command
        assert websocket_opens(f"ws://127.0.0.1:{parts.port}/?{parts.query}")


@in_proc
def test_ctrl_c_leaves_nothing_behind(tmp_path: Path) -> None:
    with studio_program(tmp_path) as (program, address):
        files = {*tmp_path.iterdir()}
        while len(begun := tree(program.pid)[1:]) < 2:  # who does the work, and the simulator's process
            time.sleep(0.05)
        program.send_signal(signal.SIGINT)
        _, err = program.communicate(timeout=60)
    assert program.returncode == 130
    assert err.strip() == "fabdesign: interrupted"
    end = time.monotonic() + 30  # Python's own helper processes end once they see that the program has
    while remaining := [child for child in begun if Path(f"/proc/{child}").exists()]:
        assert time.monotonic() < end, remaining
        time.sleep(0.05)
    with socket.socket() as connection:
        assert connection.connect_ex(("127.0.0.1", urlsplit(address).port)) != 0
    assert {*tmp_path.iterdir()} == files


def tree(process: int) -> list[int]:
    """Return a process and all that descend from it."""
    return [process, *descendants(process)]


def maps_of(process: int) -> str:
    with contextlib.suppress(OSError):  # gone meanwhile
        return Path(f"/proc/{process}/maps").read_text()
    return ""


def listening(processes: list[int]) -> set[int]:
    """Return the TCP ports that processes listen on. Raises AssertionError where another kind of socket has a name."""
    inodes = set()
    for process in processes:
        for file in Path(f"/proc/{process}/fd").glob("*"):
            with contextlib.suppress(OSError):  # closed meanwhile
                inodes.add(str(file.readlink()).removeprefix("socket:[").rstrip("]"))
    table: dict[str, Any] = {}
    for kind in ("tcp", "tcp6", "udp", "udp6", "unix"):
        with contextlib.suppress(FileNotFoundError):  # a machine without IPv6
            rows = [line.split() for line in Path(f"/proc/{processes[0]}/net/{kind}").read_text().splitlines()[1:]]
            table[kind] = [row for row in rows if row[6 if kind == "unix" else 9] in inodes]
    assert not [row for row in table["unix"] if len(row) > 7]  # no name, so nobody can connect
    assert not table["udp"] + table.get("udp6", [])
    tcp = [row for row in table["tcp"] + table.get("tcp6", []) if row[3] == "0A"]
    return {int(row[1].rpartition(":")[2], 16) for row in tcp}
