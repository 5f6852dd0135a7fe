"""Errors of kernels are named by line, and Taichi's own frontend is back after that."""

import pytest
import taichi as ti
from taichi.lang.ast.ast_transformer_utils import Builder

from sim import fields
from sim.fields import Timed


@ti.func
def inner(a):
    return a + missing  # noqa: F821


@ti.kernel
def outer(n: ti.i32):
    for i in range(n):
        inner(i)


def test_an_error_names_file_and_line():
    fields.allocate(43 * 43, 96, 43, blocks=8)
    visit = Builder.__call__
    with pytest.raises(
        ti.TaichiCompilationError, match=r"(?s)test_sim_frontend.py.*line 19, in outer.*line 13, in inner.*missing"
    ):
        Timed(outer)(1)
    assert Builder.__call__ is visit
    with pytest.raises(ti.TaichiNameError, match=r"a \+ missing"):
        outer(1)
