"""Imports go one way, and heavy libraries stay in their places."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import ROOT

PACKAGES = ("fabdesign", "sim", "corrector", "optimize", "studies")
ALLOWED = {
    "fabdesign": {"fabdesign"},
    "sim": {"fabdesign", "sim"},
    "corrector": {"fabdesign", "corrector"},
    "optimize": {"fabdesign", "optimize"},
    "studies": set(PACKAGES),
}
FILES = [file for package in PACKAGES for file in sorted((ROOT / package).rglob("*.py"))]


@cache
def imports(file: Path) -> frozenset[str]:
    """Top-level names of all modules that a file imports, anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.split(".")[0])
    return frozenset(names)


def test_packages_import_one_way() -> None:
    # the command line may import all, inside its commands; the interface is loaded when it is asked for
    free = ROOT / "fabdesign" / "cli", ROOT / "fabdesign" / "interface"
    forbidden = {
        file.relative_to(ROOT).as_posix(): imports(file) & set(PACKAGES) - ALLOWED[file.relative_to(ROOT).parts[0]]
        for file in FILES
        if file.parent not in free
    }
    assert {name: others for name, others in forbidden.items() if others} == {}


def test_no_module_imports_itself_through_others() -> None:
    """Imports at the top and inside functions; those for types alone cost nothing."""
    imported = {module: sorted(others) for module, others in _module_imports().items()}
    done: set[str] = set()

    def follow(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module not in done:
            for other in imported[module]:
                follow(other, (*path, module))
            done.add(module)

    for module in imported:
        follow(module, ())


def _module_imports() -> dict[str, set[str]]:
    """Modules of the packages that each imports."""
    names = {file: ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__") for file in FILES}
    imported: dict[str, set[str]] = {name: set() for name in names.values()}
    for file, name in names.items():
        tree = ast.parse(file.read_text(encoding="utf-8"))
        types = [node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)]
        left_out = {id(inner) for node in types for inner in ast.walk(node)}
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and id(node) not in left_out:
                for named in (f"{node.module}.{alias.name}" for alias in node.names):
                    imported[name] |= {named if named in imported else node.module} & (imported.keys() - {name})
    return imported


# rooms of `studies` whose modules the other rooms borrow; each borrows from these alone
LOWER = {"fitting", "intervals", "layout_search", "measured", "model_selection", "prediction", "report"}


def test_rooms_of_studies_meet_at_their_doors() -> None:
    """What several rooms need lies in a lower one; of any other they import what its `__init__` names."""
    studies = [file for file in FILES if file.parts[len(ROOT.parts)] == "studies"]
    rooms = {file: file.relative_to(ROOT / "studies").parts[0].removesuffix(".py") for file in studies}
    inside = []
    for file, room in rooms.items():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("studies"):
                continue
            for alias in node.names:
                _, other, *rest = f"{node.module}.{alias.name}".split(".")
                if other in (room, *LOWER, "study"):
                    continue
                if room in LOWER or len(rest) > 1 or (ROOT / "studies" / other / f"{rest[0]}.py").is_file():
                    inside.append(f"{file.relative_to(ROOT).as_posix()}: {node.module}.{alias.name}")
    assert inside == []


def test_what_no_type_check_sees_imports_what_is_there() -> None:
    """Benchmarks, scripts and examples: modules of this project by their file, names by a word in it."""
    missing = []
    for file in (
        file for room in ("benchmarks", "scripts", "examples") for file in sorted((ROOT / room).rglob("*.py"))
    ):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or not node.module:
                continue
            place = ROOT.joinpath(*node.module.split("."))
            if not (ROOT / node.module.split(".")[0]).is_dir():
                continue
            source = place.with_suffix(".py") if place.with_suffix(".py").is_file() else place / "__init__.py"
            text = source.read_text(encoding="utf-8") if source.is_file() else ""
            for name in (alias.name for alias in node.names):
                known = (place / f"{name}.py").is_file() or (place / name).is_dir() or re.search(rf"\b{name}\b", text)
                missing += [] if known else [f"{file.name}: {node.module}.{name}"]
    assert missing == []


@pytest.mark.parametrize(("library", "package"), [("taichi", "sim"), ("torch", "corrector"), ("nlopt", "optimize")])
def test_heavy_libraries_stay_in_one_package(library: str, package: str) -> None:
    users = {file.relative_to(ROOT).parts[0] for file in FILES if library in imports(file)}
    assert users <= {package}


def test_nlopt_is_imported_by_one_file() -> None:
    assert len([file for file in FILES if "nlopt" in imports(file)]) <= 1


def test_each_room_says_what_belongs_there() -> None:
    rooms = {file.parent for file in FILES}
    silent = [room for room in rooms if not ast.get_docstring(ast.parse((room / "__init__.py").read_text("utf-8")))]
    assert silent == []


def test_no_room_is_crowded() -> None:
    rooms = Counter(file.parent.relative_to(ROOT).as_posix() for file in FILES)
    assert {room: count for room, count in rooms.items() if count > 20} == {}


def test_a_class_name_stands_for_one_thing() -> None:
    named: dict[str, list[str]] = {}
    for file in FILES:
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                named.setdefault(node.name, []).append(file.relative_to(ROOT).as_posix())
    assert {name: files for name, files in named.items() if len(files) > 1} == {}


KERNELS = re.compile(r"ti\.|njit|Timed")  # compiled functions take and return numbers one by one


def _things(annotation: ast.expr | None) -> int:
    """Return how many things a function returns: the parts of a tuple, but a vector of numbers is one."""
    kind = ast.unparse(annotation).removesuffix(" | None") if annotation else ""
    node = ast.parse(kind.strip("'")).body[0] if kind.strip("'").startswith("tuple[") else None
    parts = getattr(getattr(getattr(node, "value", None), "slice", None), "elts", [])
    return 1 if {ast.unparse(part) for part in parts} in ({"float"}, {"int"}) else len(parts)


def test_functions_take_seven_things_and_return_two() -> None:
    """Verbs aside, whose parameters are the options of commands."""
    wide = set()
    for file in (file for file in FILES if file.parent != ROOT / "fabdesign" / "interface"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef) or any(KERNELS.match(ast.unparse(d)) for d in node.decorator_list):
                continue
            given = node.args
            names = {each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)} - {"self", "cls"}
            if len(names) + bool(given.vararg) + bool(given.kwarg) > 7 or _things(node.returns) > 2:
                wide.add(f"{file.relative_to(ROOT).as_posix()}: {node.name}")
    assert wide == set()


def test_tests_take_what_is_public() -> None:
    """Names that tests import, or put something else in the place of."""
    private = re.compile(rf"({'|'.join(PACKAGES)})(\.\w+)*\._[A-Za-z]\w*")
    taken = []
    for file in sorted((ROOT / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [node.value] if isinstance(node, ast.Constant) and isinstance(node.value, str) else []
            if isinstance(node, ast.ImportFrom):
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            taken += [f"{file.name}: {name}" for name in names if private.fullmatch(name)]
    assert taken == []


def test_output_has_one_door() -> None:
    inner = [f for f in FILES if re.search(r"\bfabdesign\.output\.\w", f.read_text(encoding="utf-8"))]
    assert {file.parent for file in inner} == {ROOT / "fabdesign" / "output"}


def test_distributed_is_imported_by_one_file() -> None:
    users = [file for file in FILES if {"dask", "distributed"} & imports(file)]
    assert users == [ROOT / "fabdesign" / "runtime" / "cluster.py"]


@pytest.mark.parametrize(
    "module", ["fabdesign", "fabdesign.cli", "fabdesign.nouns.catalogue", "fabdesign.files.measurement_set"]
)
def test_nouns_load_nothing_heavy(module: str) -> None:
    script = (
        f"import sys, {module}; print([m for m in ('taichi', 'torch', 'open3d', 'nlopt', 'scipy.optimize', "
        "'matplotlib', 'distributed', 'pandas', 'xarray') if m in sys.modules])"
    )
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    assert loaded.stdout.strip() == "[]"


def test_every_extra_that_is_named_exists() -> None:
    """In code and in pages, `fabdesign[NAME]` and what a missing module is said to need."""
    from fabdesign.errors import EXTRAS

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    known = set(project["optional-dependencies"])
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md"), ROOT / "Makefile"]
    named = {
        (name, file.relative_to(ROOT).as_posix())
        for file in [*FILES, *pages, *(ROOT / "examples").glob("*"), *(ROOT / "scripts").glob("*")]
        if file.is_file()
        for names in re.findall(
            r"(?:fabdesign|\.)\[([a-z][a-z0-9,-]*)\]", file.read_text(encoding="utf-8", errors="ignore")
        )
        for name in names.split(",")
    }
    assert len(named) > 5
    assert {(name, file) for name, file in named if name not in known} == set()
    assert set(EXTRAS.values()) <= known
