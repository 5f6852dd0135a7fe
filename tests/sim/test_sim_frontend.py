"""Errors of kernels are named by line, and Taichi's own frontend is back after that."""

import os
import runpy
import threading

import pytest
import taichi as ti
from taichi.lang.ast.ast_transformer_utils import Builder

from sim.kernels import fields, frontend
from sim.kernels.fields import Timed
from sim.kernels.frontend import SHORT_FRONTEND, brief


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
        ti.TaichiCompilationError, match=r"(?s)test_sim_frontend.py.*line 24, in outer.*line 18, in inner.*missing"
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


@pytest.mark.parametrize("why", ["off", "another version"])
def test_taichis_own_frontend_stays(monkeypatch, why):
    if why == "off":
        monkeypatch.setenv(SHORT_FRONTEND, "0")
    else:
        monkeypatch.setattr(frontend, "TESTED", (1, 7, 3))
    visit = Builder.__call__
    with brief():
        assert Builder.__call__ is visit
    with brief(), brief():
        assert Builder.__call__ is visit


def test_frontends_of_two_threads_leave_taichis_own():
    visit = Builder.__call__
    inside, release = threading.Event(), threading.Event()

    def first():
        with brief():
            inside.set()
            release.wait(1)

    thread = threading.Thread(target=first)
    thread.start()
    inside.wait()
    threading.Timer(0.1, release.set).start()
    with brief():
        assert Builder.__call__ is not visit
    thread.join()
    assert Builder.__call__ is visit


def test_a_module_that_is_loaded_anew_is_read_anew(tmp_path):
    # as a notebook does with a file of one's own effects
    file = tmp_path / "own_kernel.py"
    text = "import taichi as ti\n\n\n@ti.kernel\ndef answer() -> ti.i32:\n    return {}\n"
    fields.allocate(43 * 43, 96, 43, blocks=8)
    answers = []
    for k, value in enumerate((41, 42)):
        file.write_text(text.format(value))
        os.utime(file, (k, k))
        answers.append(Timed(runpy.run_path(str(file))["answer"])())
    assert answers == [41, 42]
