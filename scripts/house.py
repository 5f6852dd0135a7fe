"""Figures of the house: files and lines, names that two things share, and the longest call chain to a kernel.

python scripts/house.py                                  # files, lines, names
python scripts/house.py chain calibrate SET -o M.toml    # runs that command for two minutes, prints its longest chain
"""

import ast
import re
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = "fabdesign", "sim", "corrector", "optimize", "studies"
THOUSAND = re.compile(r"\b1e-?3 [*/]|[*/] 1e-?3\b")
SECONDS = 90.0  # of the processor that a command gets: by then it has asked for everything that it asks for


def trees() -> dict[Path, tuple[ast.Module, int]]:
    """Each Python file of the packages, parsed, and its lines."""
    files = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]
    texts = {file: file.read_text(encoding="utf-8") for file in files}
    return {file: (ast.parse(text), len(text.splitlines())) for file, text in texts.items()}


def module_of(file: Path) -> str:
    """Its name as an import says it."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_by(parsed: dict[Path, tuple[ast.Module, int]]) -> dict[str, set[str]]:
    """Of each module, those that import it or a name of it."""
    users: dict[str, set[str]] = {module_of(file): set() for file in parsed}
    for file, (tree, _) in parsed.items():
        importer = module_of(file)
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                named = [f"{node.module}.{alias.name}" for alias in node.names]
                for module in (name if name in users else node.module for name in named):
                    if module in users and module != importer:
                        users[module].add(importer)
    return users


def figures() -> dict[str, int]:
    """Return the figures of the house by name."""
    parsed = trees()
    lines = {file: count for file, (_, count) in parsed.items() if file.name != "__init__.py"}
    users = imported_by(parsed)
    classes = Counter(
        node.name
        for tree, _ in parsed.values()
        for node in tree.body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    names = Counter(node.id for tree, _ in parsed.values() for node in ast.walk(tree) if isinstance(node, ast.Name))
    return {
        "files of the packages": len(parsed),
        "lines": sum(count for _, count in parsed.values()),
        "under 60 lines": sum(count < 60 for count in lines.values()),
        "under 60 lines and imported by one other alone": sum(
            count < 60 and len(users[module_of(file)]) == 1 for file, count in lines.items()
        ),
        "of 80 to 250 lines": sum(80 <= count <= 250 for count in lines.values()),
        "over 250 lines": sum(count > 250 for count in lines.values()),
        "over 300 lines": sum(count > 300 for count in lines.values()),
        "imported by one other alone": sum(len(users[module_of(file)]) == 1 for file in lines),
        "class names that stand for several classes": sum(count > 1 for count in classes.values()),
        "variables named found, left, near, own, told or whole": sum(
            names[word] for word in ("found", "left", "near", "own", "told", "whole")
        ),
        "lines with a factor of a thousand, units.py aside": sum(
            bool(THOUSAND.search(line))
            for file in parsed
            if file.name != "units.py"
            for line in file.read_text(encoding="utf-8").splitlines()
        ),
        "dict[str, Any]": sum(ast.unparse(tree).count("dict[str, Any]") for tree, _ in parsed.values()),
        "lines of README.md": len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()),
    }


def chain_of(frame: FrameType | None) -> list[str]:
    """Functions of this program on the stack, the command first; comprehensions and lambdas are part of theirs."""
    chain = []
    while frame is not None:
        file = Path(frame.f_code.co_filename)
        if file.is_relative_to(ROOT) and file.relative_to(ROOT).parts[0] in PACKAGES:
            name = frame.f_code.co_name
            if not name.startswith("<") and name != "main":
                chain.append(f"{file.relative_to(ROOT)}: {name}")
        frame = frame.f_back
    return chain[::-1]


def longest_chain(arguments: list[str]) -> list[str]:
    """Run the command and return its longest chain to a Taichi kernel."""
    from click import Abort
    from taichi.lang.kernel_impl import Kernel

    from fabdesign.cli import commands

    longest: list[str] = []
    call = Kernel.__call__

    def watched(kernel: Any, *args: Any, **kwargs: Any) -> Any:
        nonlocal longest
        longest = max(longest, chain_of(sys._getframe(1)), key=len)
        if time.process_time() > SECONDS:
            raise KeyboardInterrupt
        return call(kernel, *args, **kwargs)

    Kernel.__call__ = watched
    with suppress(Abort):
        commands(arguments, standalone_mode=False)
    return longest


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    if sys.argv[1:2] == ["chain"]:
        print("\n".join(f"{k:3} {name}" for k, name in enumerate(longest_chain(sys.argv[2:]), start=1)))
    else:
        print("\n".join(f"{value:6}  {name}" for name, value in figures().items()))
