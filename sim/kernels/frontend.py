"""Taichi's frontend, swapped for a shorter one while kernels of this package are compiled.

Taichi walks the syntax tree of a kernel and of every function in it, call by call, before it can tell whether the
compiled kernel lies in its cache. For each call it finds, splits, wraps and parses the function's source anew, and for
every node it lays out an excerpt of that in case of an error. Here a file is parsed once, and a node that fails is
named by file and line: a warm start takes half as long. The trees are the same, and so are the kernels. Other versions
of Taichi keep their own frontend.
"""

import ast
import contextlib
import copy
import functools
import gc
import linecache
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import isqrt
from pathlib import Path
from typing import Any

import taichi
import taichi as ti
from taichi.lang import impl, kernel_impl
from taichi.lang.ast.ast_transformer_utils import ASTTransformerContext, Builder
from taichi.lang.exception import TaichiCompilationError

from fabdesign.errors import InputError, note
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.working_time import not_counted

TESTED = (1, 7, 4)  # the version of Taichi whose frontend this is
SHORT_FRONTEND = "FABDESIGN_SHORT_FRONTEND"  # environment variables: 0 turns the device off (docs/lab/compiler.md)
HIDDEN_STEPS = "FABDESIGN_HIDDEN_STEPS"  # sim/kernels/fields.py
_swapping = threading.RLock()  # one thread at a time, so that Taichi's own frontend is back after the last


def wanted(device: str) -> bool:
    """Return whether the environment variable of that name leaves the device on. Raises InputError."""
    given = os.environ.get(device, "1")
    if given not in {"0", "1"}:
        raise InputError(f"{device} is {given!r}; expected 0 or 1")
    return given == "1"


@contextlib.contextmanager
def brief() -> Iterator[None]:
    """Return a context of the short frontend, without the garbage collector, which would look through all that a kernel
    is made of."""
    if not wanted(SHORT_FRONTEND) or taichi.__version__ != TESTED:
        yield
        return
    with _swapping:
        collects = gc.isenabled()
        gc.disable()
        short = (
            (kernel_impl, "_get_tree_and_ctx", _tree_and_context),
            (Builder, "__call__", _visit),
            (ASTTransformerContext, "get_pos_info", _nothing),
            (impl, "get_traceback", _nothing),
        )
        long = [(owner, name, getattr(owner, name)) for owner, name, _ in short]
        for owner, name, function in short:
            setattr(owner, name, function)
        try:
            with impl.get_runtime().src_info_guard(""):
                yield
        finally:
            for owner, name, function in long:
                setattr(owner, name, function)
            if collects:
                gc.enable()


def _nothing(*_: Any, **__: Any) -> str:
    return ""


def _functions(file: str) -> dict[int, ast.FunctionDef]:
    """Return the functions of a file as it is now: a notebook may have loaded it anew."""
    try:
        changed = Path(file).stat().st_mtime_ns
    except OSError:  # a notebook's cell
        changed = 0
    return _parsed(file, changed)


@functools.cache
def _parsed(file: str, _: int) -> dict[int, ast.FunctionDef]:
    """Return the functions of a file by the line on which they begin, decorators included, which are then dropped."""
    linecache.checkcache(file)
    functions = {}
    for node in ast.walk(ast.parse("".join(linecache.getlines(file)))):
        if isinstance(node, ast.FunctionDef):
            first: ast.stmt | ast.expr = node.decorator_list[0] if node.decorator_list else node
            functions[first.lineno] = node
            node.decorator_list = []
    return functions


def _tree_and_context(function: Any, **given: Any) -> tuple[ast.Module, ASTTransformerContext]:
    code = function.func.__code__
    node = copy.copy(_functions(code.co_filename)[code.co_firstlineno])
    node.args = copy.copy(node.args)  # Taichi empties a kernel's list of arguments, and may compile it again
    tree = ast.Module([node], [])
    arguments, names = given.pop("args"), kernel_impl._get_global_vars(function.func)
    if given.get("is_kernel", True):
        names |= {function.arguments[i].name: arguments[i] for i in function.template_slot_locations}
    given |= {"argument_data": arguments, "global_vars": names}
    return tree, ASTTransformerContext(func=function, file=code.co_filename, src=[" "], start_lineno=1, **given)


def _visit(builder: Any, context: Any, node: ast.AST) -> Any:
    try:
        return getattr(builder, "build_" + type(node).__name__)(context, node)
    except Exception as error:
        if context.raised or not isinstance(node, ast.stmt | ast.expr):
            raise
        context.raised = True
        where = f'File "{context.file}", line {node.lineno}, in {context.func.func.__name__}:\n'
        raise TaichiCompilationError(f"{where}{type(error).__name__}: {error}") from error


SECONDS = 20  # that a costly kernel takes to compile on one core


@contextmanager
def first_call(costly: str, sizes: tuple[int, ...]) -> Iterator[None]:
    """Return a context for a kernel's first call. costly: what the kernel computes, where it takes long to compile.
    sizes: of the fields, which are part of the compiled kernel."""
    with not_counted(), brief():
        mark = _mark(costly, sizes) if costly else None
        if mark is not None and not mark.exists():
            note(f"compiling the simulator ({costly}; {_in_words(sizes)}), once on this machine: about {SECONDS} s")
        yield
        if mark is not None:
            with suppress(OSError):  # without a mark the next process says it again
                mark.parent.mkdir(parents=True, exist_ok=True)  # Taichi makes it when the process ends
                mark.touch()


def _in_words(sizes: tuple[int, ...]) -> str:
    """Return for which designs kernels of these sizes serve: of others they are compiled apart."""
    nodes, points, *_, lanes = sizes
    alone = "" if lanes == 8 else f", {lanes} at once"
    return f"grids up to {isqrt(nodes) - 2} points a side, designs up to {points} fixed points{alone}"


def _mark(costly: str, sizes: tuple[int, ...]) -> Path:
    key = sha256(f"{_sources()} {costly} {sizes}")[:24]
    return Path(ti.lang.impl.current_cfg().offline_cache_file_path) / f"fabdesign_{key}.compiled"


@functools.cache
def _sources() -> str:
    """Return a hash of what kernels are made of: this package, Taichi's version, its processor."""
    compiler = repr((ti.__version__, ti.lang.impl.current_cfg().arch))
    return sha256(compiler, *sorted(Path(__file__).parents[1].rglob("*.py")))
