"""Taichi has one runtime in a process, and each start of it drops all fields there are: those of other code too, which
then reads freed memory. A process that was forked has the runtime without its threads, and waits for them for ever.
"""

import ctypes
import gc
import os
from types import SimpleNamespace
from typing import Any

from taichi.lang import impl
from taichi.lang._ndarray import Ndarray
from taichi.lang.field import Field

from fabdesign.errors import InputError

_MARK = "_of_fabdesign"
_forked: list[Any] = []


def runtime() -> Any:
    """Return what a start of Taichi makes; None before the first, and after `ti.reset()`."""
    return impl.get_runtime().prog


def require_no_fork() -> None:
    """Raise InputError in a process that was forked from one in which Taichi ran."""
    if _forked:
        raise InputError(
            "this process was forked after Taichi had started, and Taichi does not survive that; expected a process "
            'started by spawn: multiprocessing.get_context("spawn")'
        )


def require_unshared() -> None:
    """Raise InputError where a start of Taichi would drop fields of other code."""
    if runtime() is None:
        return
    for value in gc.get_objects():
        if issubclass(type(value), Field | Ndarray) and not hasattr(value, _MARK):
            raise InputError(
                "other code of this process has fields in Taichi, which fabdesign would drop; expected it in a process "
                "of its own (multiprocessing, spawn), or ti.reset() where its fields are no longer needed"
            )


def mark(*spaces: SimpleNamespace) -> None:
    """Say that the fields in these namespaces are this program's."""
    for space in spaces:
        for field in vars(space).values():
            if isinstance(field, Field):
                for part in (field, field.grad, field.dual):
                    if part is not None:
                        setattr(part, _MARK, True)


def watch_forks(lock: Any) -> None:
    """Free the lock in a child that is forked, where its thread may be missing, and remember what the child is."""

    def after() -> None:
        lock._at_fork_reinit()  # what the standard library does with its own
        if runtime() is not None:
            _forked.append(runtime())
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(runtime()))  # its destructor would wait too

    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=after)
