"""How the parts of the panel ask: a person's input goes to the session's thread, the program's own does not."""

from collections.abc import Callable
from typing import Any

Post = Callable[[Callable[[], None]], None]


def on_input(handle: Any, post: Post, then: Callable[[Any], None]) -> None:
    """Call `then(value)` on the session's thread when a person, in any tab, has changed an input."""

    def changed(event: Any) -> None:
        if event.client is not None:  # else the program set it
            value = handle.value
            post(lambda: then(value))

    handle.on_update(changed)


def on_click(handle: Any, post: Post, then: Callable[[], None]) -> None:
    handle.on_click(lambda _: post(then))


def markdown(text: str) -> str:
    """Return Markdown without HTML, which viser would run: names of files and designs stand in it."""
    return text.replace("<", "&lt;")


def put(handle: Any, value: Any) -> None:
    """Show a value where it is another: what is being typed is not disturbed."""
    if handle.value != value:
        handle.value = value
