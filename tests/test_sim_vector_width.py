"""LLVM packs eight floats into one operation, also for a processor that it does not know."""

import subprocess
import sys
from pathlib import Path

import pytest

from sim.kernels import vector_width
from sim.kernels.devices import WIDE_VECTORS

# a kernel after widen() on a processor that LLVM is said not to know
PACKED = """
import sys
import taichi as ti
from sim.kernels import vector_width
vector_width.known_to_llvm = lambda _: False
vector_width.OPTION = b"-slp-max-reg-size=" + sys.argv[1].encode()
print(vector_width.widen())
ti.init(arch=ti.cpu, offline_cache=False, print_kernel_llvm_ir_optimized=True)
x = ti.Vector.field(8, ti.f32, shape=64)

@ti.kernel
def double():
    ti.loop_config(serialize=True)
    for i in range(64):
        x[i] = 2.0 * x[i]

double()
"""
# two starts of Taichi, and where kernels are kept after each
TWICE = """
import taichi as ti
from sim.kernels import fields, vector_width
vector_width.known_to_llvm = lambda _: False
for side in 43, 83:
    fields.allocate(side * side, 96, side, blocks=1)
    print(vector_width.widen(), ti.lang.impl.default_cfg().offline_cache_file_path)
"""
ZEN_3, ZEN_5, INTEL, UNKNOWN = (
    f"processor\t: 0\nvendor_id\t: {vendor}\ncpu family\t: {family}\nmodel\t\t: 17\nflags\t\t: fpu avx2\n"
    for vendor, family in (("AuthenticAMD", 25), ("AuthenticAMD", 26), ("GenuineIntel", 6), ("HygonGenuine", 24))
)


def printed(code: str, folder: Path, *arguments: str) -> str:
    """What a process of its own prints last; skips where it says that vectors are as they were."""
    script = folder / "script.py"
    script.write_text(code)
    command = [sys.executable, str(script), *arguments]
    said = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True, timeout=120).stdout
    if "True" not in said:
        pytest.skip("another system, processor or Taichi")
    return said


@pytest.mark.parametrize("bits, floats", [("128", 4), ("256", 8)])
def test_as_many_floats_as_that_width_takes(tmp_path, bits, floats):
    printed(PACKED, tmp_path, bits)
    code = "".join(file.read_text() for file in tmp_path.glob("*.ll"))
    assert [n for n in (4, 8, 16) if f"fmul reassoc ninf nsz <{n} x float>" in code] == [floats]


def test_kernels_of_that_width_have_one_folder_however_often_taichi_starts(tmp_path, monkeypatch):
    monkeypatch.setenv("TI_OFFLINE_CACHE_FILE_PATH", str(tmp_path / "kept"))
    lines = [line for line in printed(TWICE, tmp_path).splitlines() if line.startswith("True")]
    assert lines == [f"True {tmp_path / 'kept'}_wide"] * 2


def test_processors_that_llvm_does_not_know():
    known = vector_width.known_to_llvm
    assert [known(said) for said in (ZEN_3, INTEL)] == [True, True]
    assert [known(said) for said in (ZEN_5, UNKNOWN, "processor\t: 0\n")] == [False, False, False]


@pytest.fixture
def unknown_processor(tmp_path, monkeypatch):
    """A Zen 5, and no call of the function that reads options; as on it, but for system and version."""
    said, calls = tmp_path / "cpuinfo", []
    said.write_text(ZEN_5)
    monkeypatch.setattr(vector_width, "PROCESSOR", said)
    monkeypatch.setattr(vector_width, "_function", lambda _: lambda *given: calls.append(given))
    if not vector_width.widen.__wrapped__():
        pytest.skip("another system or Taichi")
    return calls


def test_nothing_is_called_where_it_is_off_or_unknown(unknown_processor, monkeypatch):
    unknown_processor.clear()
    for where, name, value in (
        ("sim.kernels.vector_width", "tested", lambda: False),
        ("sim.kernels.vector_width", "has_avx2", lambda: False),
        ("sim.kernels.vector_width", "known_to_llvm", lambda _: True),
        ("platform", "machine", lambda: "aarch64"),
    ):
        with monkeypatch.context() as changed:
            changed.setattr(f"{where}.{name}", value)
            assert not vector_width.widen.__wrapped__()
    monkeypatch.setenv(WIDE_VECTORS, "0")
    assert not vector_width.widen.__wrapped__()
    assert unknown_processor == []


def test_a_library_without_a_symbol_table_is_left_alone(tmp_path):
    # an ELF header with no sections and no segments
    library = tmp_path / "empty.so"
    library.write_bytes(b"\x7fELF" + bytes(60))
    assert vector_width.symbol_values(library, ("main",)) == {}
    assert vector_width.code(library, 0) == b""


def test_a_function_is_called_only_where_memory_holds_its_code(monkeypatch):
    from taichi._lib.core import taichi_python

    library = Path(taichi_python.__file__)
    values = vector_width.symbol_values(library, (vector_width.READER, "no_such_symbol"))
    if not values:
        pytest.skip("another system or Taichi")
    assert set(values) == {vector_width.READER}
    assert vector_width._function(library) is not None
    assert vector_width.in_memory(0, 8) == b""
    monkeypatch.setattr(vector_width, "in_memory", lambda *_: bytes(vector_width.COMPARED))
    assert vector_width._function(library) is None
