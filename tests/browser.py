"""A headless chromium, driven over its remote-debugging port."""

import base64
import json
import os
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

_SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")


def chromium() -> str | None:
    """The program, where one is installed."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((path for name in names if (path := shutil.which(name))), None)


class Navigated(AssertionError):
    """The page went elsewhere while it was asked."""


_FIELD = """(() => {
  let node = [...document.querySelectorAll('label')].find(label => label.innerText.trim() == %s);
  const inputs = () => [...node.querySelectorAll('input')].filter(input => input.getBoundingClientRect().width > 5);
  while (node && inputs().length <= %d) node = node.parentElement;
  if (!node) return null;
  const input = inputs()[%d];
  input.scrollIntoView({block: 'center'});
  const box = input.getBoundingClientRect();
  return [box.x + box.width / 3, box.y + box.height / 2, input.value];
})()"""
_BUTTON = """(() => {
  const button = [...document.querySelectorAll('body *')].find(e => !e.children.length && e.innerText?.trim() == %s);
  if (!button) return null;
  button.scrollIntoView({block: 'center'});
  const box = button.getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2];
})()"""


_SLOW_FRAMES = """(() => {
  const soon = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = draw => setTimeout(() => soon(draw), 80);
  window.cancelAnimationFrame = clearTimeout;
})()"""


class Page:
    """One tab."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._number = socket, 0

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=300))
            if answer.get("id") == self._number:
                if "navigated" in answer.get("error", {}).get("message", ""):
                    raise Navigated(method)
                assert "error" not in answer, answer
                return answer["result"]

    def run(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def wait(self, script: str, *, seconds: float = 15.0) -> Any:
        """The value of an expression, once it is true; a page on its way elsewhere is asked again there."""
        end = time.monotonic() + seconds
        while True:
            with suppress(Navigated):
                if value := self.run(script):
                    return value
            assert time.monotonic() < end, f"waited {seconds} s in vain for {script}; the page says {self.text()}"
            time.sleep(0.05)

    def field(self, label: str, number: int = 0) -> Any:
        """Where an input beside a label is: x, y, and what it holds."""
        return self.run(_FIELD % (json.dumps(label), number, number))

    def fill(self, label: str, text: str, number: int = 0) -> None:
        self.wait(_FIELD % (json.dumps(label), number, number))
        x, y, _ = self.field(label, number)
        self.click(x, y)
        self.type(text)

    def press(self, button: str) -> None:
        """A button or a tab, by what stands on it."""
        x, y = self.wait(_BUTTON % json.dumps(button))
        self.click(x, y)

    def press_button(self, label: str) -> None:
        """A button, where the same words stand elsewhere too."""
        button = f"[...document.querySelectorAll('button')].find(b => b.innerText.trim() == {json.dumps(label)})"
        self.wait(f"(b => b && !b.disabled && (b.click() || true))({button})")

    def open_tab(self, label: str) -> None:
        """A tab of the panel, wherever it lies meanwhile: what stands above it grows and shrinks."""
        tab = f"[...document.querySelectorAll('[role=tab]')].find(e => e.innerText.trim() == {json.dumps(label)})"
        kinds = json.dumps(["pointerdown", "mousedown", "pointerup", "mouseup", "click"])
        event = (
            "new (kind.startsWith('p') ? PointerEvent : MouseEvent)(kind, {bubbles: true, button: 0, isPrimary: true})"
        )
        self.wait(f"(tab => tab && ({kinds}.forEach(kind => tab.dispatchEvent({event})) || true))({tab})")
        self.wait(f"{tab}.getAttribute('aria-selected') != 'false'")

    def text(self) -> str:
        return str(self.run("document.body ? document.body.innerText : ''"))

    def mouse(self, kind: str, x: float, y: float, *, pressed: bool = False) -> None:
        """kind: "Pressed", "Moved" or "Released"."""
        button = "none" if kind == "Moved" and not pressed else "left"
        self.call(
            "Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, button=button, buttons=int(pressed),
            clickCount=int(kind != "Moved"),
        )  # fmt: skip

    def click(self, x: float, y: float) -> None:
        self.mouse("Moved", x, y)
        self.mouse("Pressed", x, y, pressed=True)
        self.mouse("Released", x, y)

    def type(self, text: str) -> None:
        """In place of what the field in focus holds, and Enter."""
        self.key("a", "KeyA", 65, modifiers=2)
        self.call("Input.insertText", text=text)
        self.key("Enter", "Enter", 13)

    def key(self, key: str, code: str, number: int, *, modifiers: int = 0) -> None:
        for kind in ("rawKeyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent", type=kind, key=key, code=code, windowsVirtualKeyCode=number,
                modifiers=modifiers, commands=["selectAll"] if modifiers else [],
            )  # fmt: skip

    def shot(self) -> bytes:
        """What is seen, a PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])


@contextmanager
def browser_at(
    address: str, profile: Path, *, width: int = 1600, height: int = 900, frugal: bool = False
) -> Iterator[Page]:
    """A tab of a new chromium at `address`; its profile goes into the folder `profile`. frugal: half of the pixels each
    way, and some ten frames a second; without a graphics card a scene takes a processor's time by both."""
    from websockets.sync.client import connect

    program = chromium()
    assert program is not None
    sandbox = ("--no-sandbox",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()
    process = subprocess.Popen(
        [program, "--headless=new", "--remote-debugging-port=0", f"--user-data-dir={profile}", "--no-first-run",
         "--disable-dev-shm-usage", "--disable-extensions", "--disable-background-networking", "--hide-scrollbars",
         f"--window-size={width},{height}", *_SOFTWARE, *sandbox, "about:blank"],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        port = _port(profile / "DevToolsActivePort", process)
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=10) as answer:
            tab = next(entry for entry in json.load(answer) if entry["type"] == "page")
        with connect(tab["webSocketDebuggerUrl"], max_size=None) as socket:
            page = Page(socket)
            page.call("Page.enable")
            page.call(
                "Emulation.setDeviceMetricsOverride", width=width, height=height,
                deviceScaleFactor=0.5 if frugal else 1, mobile=False,
            )  # fmt: skip
            if frugal:
                page.call("Page.addScriptToEvaluateOnNewDocument", source=_SLOW_FRAMES)
            page.call("Page.navigate", url=address)
            yield page
    finally:
        process.terminate()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _port(file: Path, process: subprocess.Popen[bytes]) -> int:
    end = time.monotonic() + 20
    while time.monotonic() < end and process.poll() is None:
        if file.is_file() and (lines := file.read_text().splitlines()):
            return int(lines[0])
        time.sleep(0.05)
    raise AssertionError(f"chromium did not start (code {process.poll()})")
