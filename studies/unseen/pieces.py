"""Results of a study piece by piece, each kept in a file as soon as it is there."""

import json
import time
from collections.abc import Callable, Mapping
from typing import Any

from fabdesign.output import WorkFolder, write_text
from optimize.history import OtherStudy, differences

FOLDER = "pieces"
_CONTENT = "study.json"


class Pieces:
    """Pieces of one study in `pieces/NAME.json` of its folder.

    content: what they depend on, by field. seconds: after so much computing no further piece is begun; None: no limit.
    Raises OtherStudy, which says what differs, where the folder has pieces of another study.
    """

    def __init__(self, work: WorkFolder, content: Mapping[str, str], seconds: float | None) -> None:
        self._work, self._seconds = work, seconds
        self._folder = work.folder / FOLDER
        file = self._folder / _CONTENT
        if file.is_file():
            known = json.loads(file.read_text(encoding="utf-8"))
            if known != content:
                if not work.anew:
                    raise OtherStudy(
                        f"{work.folder}: holds another study ({differences(known, content)}); expected the same one, "
                        "or --force to start anew"
                    )
                work.clear()
        self._folder.mkdir(exist_ok=True)
        self._keep(_CONTENT, dict(content))

    @property
    def spent(self) -> float:
        """s of computing, all sessions together."""
        files = [file for file in self._folder.glob("*.json") if file.name != _CONTENT]
        return float(sum(json.loads(file.read_text(encoding="utf-8"))["seconds"] for file in files))

    def has(self, name: str) -> bool:
        """Whether a piece of this name is kept."""
        return (self._folder / f"{name}.json").is_file()

    def piece(self, name: str, compute: Callable[[], Any]) -> Any:
        """What is kept of this name, else computed and kept; None where there is no time to begin it."""
        file = self._folder / f"{name}.json"
        if file.is_file():
            return json.loads(file.read_text(encoding="utf-8"))["found"]
        if self._seconds is not None and self.spent >= self._seconds:
            return None
        begun = time.monotonic()
        found = compute()
        self._keep(file.name, {"found": found, "seconds": time.monotonic() - begun})
        return found

    def _keep(self, name: str, content: Any) -> None:
        self._work.claim(f"{FOLDER}/{name}")
        write_text(self._folder / name, json.dumps(content) + "\n")
