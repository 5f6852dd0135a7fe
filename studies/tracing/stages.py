"""Finished stages of a trace, kept as files, so that one that was killed goes on where it stood."""

import hashlib
import json
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fabdesign.errors import InputError
from fabdesign.output import WorkFolder, whole_file, write_text

Arrays = dict[str, np.ndarray]
_CONTENT = "stages/content.json"


class AnotherTrace(InputError):
    """The folder holds one of other data, options or code."""


class Stages:
    """What was computed in a run's folder, by the name of its stage. content: what the run depends on, by field.

    Raises AnotherTrace where the folder holds another run, with what differs, unless the folder is worked in anew.
    """

    def __init__(self, work: WorkFolder, content: Mapping[str, str]) -> None:
        self._work = work
        file = work.folder / _CONTENT
        if file.is_file():
            known = json.loads(file.read_text(encoding="utf-8"))
            differ = [name for name in {*known, *content} if known.get(name) != content.get(name)]
            if not differ:
                return
            if not work.anew:
                raise AnotherTrace(
                    f"{work.folder}: holds another trace: {', '.join(sorted(differ)[:4])} differ; expected another "
                    "folder, or --force"
                )
            work.clear()
        work.claim(_CONTENT)
        write_text(file, json.dumps(dict(content), indent=1) + "\n")

    def of(self, name: str, compute: Callable[[], Arrays]) -> Arrays:
        """The arrays of a stage, computed unless they are there."""
        stage = f"stages/{name}.npz"
        file = self._work.folder / stage
        if file.is_file():
            try:
                with np.load(file, allow_pickle=False) as kept:
                    return {key: kept[key] for key in kept.files}
            except (OSError, ValueError, zipfile.BadZipFile):
                pass  # damaged: it is computed again
        arrays = compute()
        self._work.claim(stage)
        with whole_file(file) as temporary, temporary.open("wb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]
        return arrays

    def text(self, name: str, compute: Callable[[], Any]) -> Any:
        """The same of what JSON can hold."""
        arrays = self.of(name, lambda: {"json": np.array(json.dumps(compute()))})
        return json.loads(str(arrays["json"]))


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
