"""A kernel's first call, in which Taichi compiles it, or loads what it has compiled on this machine.

That takes the seconds of nothing else (`working_time`). A kernel that takes long to compile says so, unless
a mark in Taichi's folder tells that it lies there. Marks hold for the very source and fields.
"""

import functools
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from math import isqrt
from pathlib import Path

import taichi as ti

from fabdesign.errors import note
from fabdesign.runtime.fingerprint import sha256
from fabdesign.runtime.working_time import not_counted
from sim.kernels.frontend import brief

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
    nodes, points, *_ = sizes
    return f"grids up to {isqrt(nodes) - 2} points a side, designs up to {points} fixed points"


def _mark(costly: str, sizes: tuple[int, ...]) -> Path:
    key = sha256(f"{_sources()} {costly} {sizes}")[:24]
    return Path(ti.lang.impl.current_cfg().offline_cache_file_path) / f"fabdesign_{key}.compiled"


@functools.cache
def _sources() -> str:
    """Return a hash of what kernels are made of: this package, Taichi's version, its processor."""
    compiler = repr((ti.__version__, ti.lang.impl.current_cfg().arch))
    return sha256(compiler, *sorted(Path(__file__).parents[1].rglob("*.py")))
