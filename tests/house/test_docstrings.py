"""Docstrings have a subject or a verb, and names say what a thing is."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.conftest import ROOT
from tests.house.test_imports import FILES

# of modules and classes, which may open with a noun
NEITHER = re.compile(
    r"(Of|What|By|The same|As|Than|Into|Within|Without|On|In|From|For|To|At|With|Over|Beside|Between)\b"
)
# of functions: what they do; a new verb is added here
VERBS = re.compile(
    r"(Add|Advance|Ask|Begin|Bring|Call|Change|Check|Choose|Compare|Compile|Compute|Copy|Count|Declare|Decode|Design|"
    r"Do|Draw|Drop|End|Evaluate|Exit|Factor|Find|Fit|Free|Fuse|Give|Go|Hand|Have|Hold|Keep|Kill|Learn|Leave|Let|List|"
    r"Listen|Log|Make|Mark|Measure|Move|Note|Open|Pair|Place|Play|Predict|Print|Put|Raise|Read|Refuse|Register|"
    r"Remove|Rename|Replace|Require|Restore|Return|Run|Save|Say|Search|See|Select|Set|Shift|Show|Simulate|Split|"
    r"Stand|Start|Step|Stop|Switch|Take|Tell|Trace|Train|Undo|Wait|Write|Yield)\b"
)
# kernels write equations; a decorator that declares an effect takes the docstring for a description of that effect
EQUATIONS = re.compile(r"ti\.|njit|Timed|effect\(|pressure_effect")


def bad_openings(file: Path) -> Iterator[str]:
    """Yield the docstrings of a file that open with neither."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) or not (text := ast.get_docstring(node)):
            continue
        if isinstance(node, ast.FunctionDef):
            equations = any(EQUATIONS.match(ast.unparse(mark)) for mark in node.decorator_list)
            bad = not equations and not VERBS.match(text)
        else:
            bad = bool(NEITHER.match(text))
        if bad:
            yield f"{file.relative_to(ROOT).as_posix()}:{getattr(node, 'lineno', 1)}: {text.splitlines()[0]}"


def test_docstrings_open_with_a_subject_or_a_verb() -> None:
    assert [line for file in FILES for line in bad_openings(file)] == []


# words that say how a thing came about or where it lies, not what it is
NO_NOUNS = {"doubts", "few", "found", "left", "much", "near", "own", "said", "sure", "told", "whole"}
SIDES = "left side or edge, as drawn"
EXCEPTIONS = {
    "fabdesign/depth/intrinsics.py: left": SIDES,
    "fabdesign/drawings/pages.py: left": SIDES,
    "fabdesign/drawings/sewing.py: left": SIDES,
    "fabdesign/drawings/template.py: left": SIDES,
    "fabdesign/geometry/placement.py: left": "left edge of a target; left singular vectors",
    "fabdesign/geometry/wishes.py: left": SIDES,
    "fabdesign/nouns/catalogue.py: left": SIDES,
    "scripts/rooms_picture.py: left": SIDES,
    "scripts/studio_moving_picture.py: left": SIDES,
    "sim/grid.py: LEFT": SIDES,
    "studies/loop/record.py: said": "a key of the loop's kept turns",
    "studies/report/page.py: left_aligned": "cells of a table",
    "studies/studio/widgets/flat_view.py: left": SIDES,
    "studies/studio/widgets/hung_view.py: left": SIDES,
    "studies/studio/widgets/page.py: near": "viser's name for a camera's near plane",
    "studies/studio/widgets/status.py: left": SIDES,
    "tests/report/test_export.py: left": SIDES,
    "tests/search/test_mirror.py: left": SIDES,
    "tests/studio/test_studio_browser.py: left": SIDES,
}
EVERY = [
    *FILES,
    *(file for room in ("benchmarks", "examples", "scripts", "tests") for file in (ROOT / room).rglob("*.py")),
]


def names_of(tree: ast.AST) -> Iterator[str]:
    """Yield the names that a file gives: variables, parameters, attributes, functions but tests, classes, imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("test_"):
            yield node.name
        elif isinstance(node, ast.alias) and node.asname:
            yield node.asname


def test_names_say_what_a_thing_is() -> None:
    """`left_out` is the term for what is not used; a file's name in a package counts as the others."""
    names = [(file, file.stem) for file in FILES]
    names += [(file, name) for file in EVERY for name in names_of(ast.parse(file.read_text(encoding="utf-8")))]
    vague = {
        f"{file.relative_to(ROOT).as_posix()}: {name}"
        for file, name in names
        if NO_NOUNS & {*name.lower().replace("left_out", "").split("_")}
    }
    assert vague == EXCEPTIONS.keys()


# what a parameter that is true or false may say. A choice between two ways to work is a role, a policy, an enum, or two
# functions; a new name is added here with what it says
FLAGS = {
    "an option of a command, as it was typed": """all_trials as_json covariance equilibrium force no_browser overlay
        per_frame positions pressures replace self_contact skip_bad""",
    "a fact about what is given": """across anew cause commas converged down drawn effects even_targets free
        known on_front one_way ordered part released shared sized stretched tangential_on_radial unit_known
        upright wished""",
    "what is asked for stands so in what is written or shown": """anywhere bad browser closed comments disabled halts
        integer limits middle of_search selected vector verbose with_rest""",
    "what a hand did in the studio, or a loop's turn that ends it": "_last corrected fitted last on value",
    "whether a number is exact, or a shape at rest": "exact settles",
}


def test_parameters_that_are_true_or_false_state_a_fact() -> None:
    flags = {
        given.arg
        for file in FILES
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
        for given in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        if given.annotation and "bool" in ast.unparse(given.annotation).split(" | ")
    }
    assert flags == {name for names in FLAGS.values() for name in names.split()}
