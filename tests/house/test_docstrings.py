"""Docstrings have a subject or a verb: a few openings that have neither are refused."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.conftest import ROOT
from tests.house.test_imports import FILES

NEITHER = re.compile(
    r"(Of|What|By|The same|As|Than|Into|Within|Without|On|In|From|For|To|At|With|Over|Beside|Between)\b"
)
NO_VERB = re.compile(
    rf"{NEITHER.pattern}|(Those|Where|Whether|How|Why|Every|Each|All|The|An?)\b|[^A-Z]|[A-Z]\w*[^\w\s,]"
)
NO_NOUNS = {"found", "own", "sure", "told"}


def openings(file: Path) -> Iterator[tuple[int, str, bool]]:
    """Yield line and docstring of all that has one, and whether it is a function that returns something."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) or not (text := ast.get_docstring(node)):
            continue
        returns = False
        if isinstance(node, ast.FunctionDef):
            marks = [ast.unparse(mark) for mark in node.decorator_list]
            kernel = any(mark.startswith("ti.") or mark.endswith("property") for mark in marks)
            returns = not kernel and node.returns is not None and ast.unparse(node.returns) != "None"
        yield getattr(node, "lineno", 1), text, returns


def test_docstrings_open_with_a_subject_or_a_verb() -> None:
    bad = [
        f"{file.relative_to(ROOT).as_posix()}:{line}: {text.splitlines()[0]}"
        for file in FILES
        for line, text, returns in openings(file)
        if (NO_VERB if returns else NEITHER).match(text)
    ]
    assert bad == []


def test_variables_say_what_they_are() -> None:
    """`found` and `own` are no nouns."""
    bad = [
        f"{file.relative_to(ROOT).as_posix()}:{node.lineno}: {word}"
        for file in FILES
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if (word := getattr(node, "arg", None) if isinstance(node, ast.arg) else getattr(node, "id", None)) in NO_NOUNS
        and not isinstance(getattr(node, "ctx", None), ast.Load)
    ]
    assert bad == []
