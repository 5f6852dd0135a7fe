"""The program: the console script and `python -m fabdesign`. Nothing heavy is loaded before signals are answered."""

import os
import sys
from contextlib import suppress

from fabdesign.runtime.supervisor import supervised


def main() -> None:
    """Run the command line in a child process of this one."""
    _import_nothing_of_the_user()
    supervised(command_line, _give_up)


def _import_nothing_of_the_user() -> None:
    """Take the working folder, in which a file may be called http.py, from the places of modules, for this process and
    those that it starts; but not where this program itself lies there."""
    if sys.flags.safe_path:
        return
    with suppress(OSError):  # a folder that is gone
        # not pathlib, which takes its time
        if os.path.samefile(sys.path[0] or os.curdir, f"{os.path.dirname(__file__)}/.."):  # noqa: PTH120, PTH121
            return
    del sys.path[0]  # that folder, or that of the console script
    os.environ.setdefault("PYTHONSAFEPATH", "1")


def command_line() -> None:
    from fabdesign.cli import main

    main()


def _give_up(records: list[dict[str, object]]) -> list[str]:
    from fabdesign.output import given_up

    return given_up(records)


if __name__ == "__main__":
    main()
