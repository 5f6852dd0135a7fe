"""Errors of kernels are named by line, and Taichi's own frontend is back after that."""

import pytest
import taichi as ti
from taichi.lang.ast.ast_transformer_utils import Builder

from sim.kernels import fields
from sim.kernels.fields import Timed
from sim.kernels.frontend import brief


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
        ti.TaichiCompilationError, match=r"(?s)test_sim_frontend.py.*line 20, in outer.*line 14, in inner.*missing"
    ):
        Timed(outer)(1)
    assert Builder.__call__ is visit
    with pytest.raises(ti.TaichiNameError, match=r"a \+ missing"):
        outer(1)


@ti.kernel
def sum_to(doubled: ti.template(), n: ti.i32) -> ti.i32:
    total = 0
    for i in range(n):
        total += 2 * i if ti.static(doubled) else i
    return total


def test_a_kernel_compiles_as_often_as_it_must():
    # here for two values of a template argument; after fields have grown, all kernels do
    fields.allocate(43 * 43, 96, 43, blocks=8)
    with brief():
        assert [sum_to(False, 5), sum_to(True, 5), sum_to(False, 3)] == [10, 20, 3]
