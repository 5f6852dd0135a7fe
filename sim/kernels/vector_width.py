"""How many floats LLVM packs into one operation.

Taichi's LLVM 15 takes processors that came after it, Zen 4 among them, for the first x86-64 and packs 4 floats, not 8:
the kernels then take 1.6 times as long. LLVM's option for that width is set here. The function that reads such options
is not among those that Taichi exports, but stands in its library's symbol table.
"""

import ctypes
import functools
import mmap
import platform
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import taichi

TESTED = (1, 7, 4)
OPTION = b"-slp-max-reg-size=256"
ANCHOR = "PyInit_taichi_python"  # exported: says where the library lies in memory
READER = "LLVMParseCommandLineOptions"
_SYMBOL = np.dtype([("name", "<u4"), ("kind", "<u4"), ("value", "<u8"), ("size", "<u8")])  # Elf64_Sym
_SYMBOL_TABLE = 2  # SHT_SYMTAB


@functools.cache
def widen() -> bool:
    """Have LLVM pack 8 floats where the processor can; before Taichi compiles anything. Whether that was done: not for
    other versions, systems and processors, where it decides by itself."""
    if taichi.__version__ != TESTED or (sys.platform, platform.machine()) != ("linux", "x86_64"):
        return False
    if not has_avx2():
        return False
    from taichi._lib.core import taichi_python

    reader = _function(Path(taichi_python.__file__))
    if reader is None:
        return False
    reader(2, (ctypes.c_char_p * 2)(b"fabdesign", OPTION), None)
    return True


def has_avx2() -> bool:
    """Whether the processor says so; only Linux asks it here."""
    processor = Path("/proc/cpuinfo")
    return processor.exists() and "avx2" in processor.read_text().split()


def _function(library: Path) -> Callable[..., Any] | None:
    values = symbol_values(library, (ANCHOR, READER))
    if len(values) < 2:
        return None
    anchor = ctypes.cast(getattr(ctypes.PyDLL(str(library)), ANCHOR), ctypes.c_void_p).value or 0
    kind = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.POINTER(ctypes.c_char_p), ctypes.c_char_p)
    return kind(anchor - values[ANCHOR] + values[READER])


def symbol_values(library: Path, names: tuple[str, ...]) -> dict[str, int]:
    """Addresses, relative to where an ELF library is loaded, of those symbols that its table has."""
    values: dict[str, int] = {}
    with library.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        (start,), (size, count) = struct.unpack_from("<Q", data, 0x28), struct.unpack_from("<HH", data, 0x3A)
        sections = [struct.unpack_from("<IIQQQQIIQQ", data, start + k * size) for k in range(count)]
        for _, kind, _, _, first, length, link, *_ in sections:
            if kind != _SYMBOL_TABLE:
                continue
            begin, end = sections[link][4], sections[link][4] + sections[link][5]
            known = np.frombuffer(data, _SYMBOL, length // _SYMBOL.itemsize, first)
            place, value = known["name"].copy(), known["value"].copy()
            del known  # a view would keep the file open
            for name in names:
                found = data.find(b"\0" + name.encode() + b"\0", begin, end) + 1
                rows = np.flatnonzero(place == found - begin) if found else ()
                if len(rows):
                    values[name] = int(value[rows[0]])
    return values
