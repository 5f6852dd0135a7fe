"""LLVM packs eight floats into one operation, also for a processor that it does not know."""

import subprocess
import sys
from pathlib import Path

import pytest

from sim.kernels import vector_width

PACKED = """
import sys
import taichi as ti
from sim.kernels.vector_width import widen
if sys.argv[1] == "wide":
    print(widen())
ti.init(arch=ti.cpu, offline_cache=False, print_kernel_llvm_ir_optimized=True)
x = ti.Vector.field(8, ti.f32, shape=64)

@ti.kernel
def double():
    ti.loop_config(serialize=True)
    for i in range(64):
        x[i] = 2.0 * x[i]

double()
"""


def packed(folder: Path, how: str) -> tuple[str, bool]:
    """What a process of its own prints, and whether one of its kernels multiplies eight floats at once."""
    script = folder / "packed.py"
    script.write_text(PACKED)
    command = [sys.executable, str(script), how]
    run = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True, timeout=120)
    return run.stdout, any("fmul reassoc ninf nsz <8 x float>" in file.read_text() for file in folder.glob("*.ll"))


def test_eight_floats_where_the_processor_can(tmp_path):
    said, eight = packed(tmp_path, "wide")
    if "True" not in said:
        pytest.skip("another system, processor or Taichi")
    assert eight


def test_a_library_without_a_symbol_table_is_left_alone(tmp_path):
    # an ELF header with no sections
    library = tmp_path / "empty.so"
    library.write_bytes(b"\x7fELF" + bytes(60))
    assert vector_width.symbol_values(library, ("main",)) == {}


def test_symbols_of_this_library():
    from taichi._lib.core import taichi_python

    if not vector_width.widen():
        pytest.skip("another system, processor or Taichi")
    values = vector_width.symbol_values(Path(taichi_python.__file__), (vector_width.READER, "no_such_symbol"))
    assert set(values) == {vector_width.READER}
