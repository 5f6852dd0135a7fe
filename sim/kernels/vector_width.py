"""How many floats LLVM packs into one operation.

Taichi's LLVM 15 takes processors of AMD that came after it, from Zen 5 on, for the first x86-64 and packs 4 floats, not
8: the kernels then take 1.4 times as long. LLVM's option for that width is set here. The function that reads such
options is not among those that Taichi exports, but stands in its library's symbol table. It is called only where memory
holds its code as the library's file has it; an option that this LLVM does not have it passes over.
"""

import ctypes
import functools
import mmap
import platform
import re
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sim.kernels.devices import WIDE_VECTORS, tested, wanted

PROCESSOR = Path("/proc/cpuinfo")
OPTION = b"-slp-max-reg-size=256"
ANCHOR = "PyInit_taichi_python"  # exported: says where the library lies in memory
READER = "LLVMParseCommandLineOptions"
_SYMBOL = np.dtype([("name", "<u4"), ("kind", "<u4"), ("value", "<u8"), ("size", "<u8")])  # Elf64_Sym
_SYMBOL_TABLE = 2  # SHT_SYMTAB
_LOADED, _EXECUTABLE = 1, 1  # PT_LOAD, PF_X
COMPARED = 64  # bytes


@functools.cache
def widen() -> bool:
    """Have LLVM pack 8 floats where the processor can and LLVM does not know that; before Taichi compiles anything.
    Whether that was done: not for other versions and systems."""
    if not wanted(WIDE_VECTORS) or not tested() or (sys.platform, platform.machine()) != ("linux", "x86_64"):
        return False
    if not has_avx2() or known_to_llvm(PROCESSOR.read_text()):
        return False
    from taichi._lib.core import taichi_python

    reader = _function(Path(taichi_python.__file__))
    if reader is None:
        return False
    reader(2, (ctypes.c_char_p * 2)(b"fabdesign", OPTION), None)
    return True


def has_avx2() -> bool:
    """Whether the processor says so; only Linux asks it here."""
    return PROCESSOR.exists() and "avx2" in PROCESSOR.read_text().split()


def known_to_llvm(processor: str) -> bool:
    """Whether LLVM 15 finds out what a processor can, by what Linux says of it: it knows AMD's families up to 25 (Zen 3
    and 4) and guesses Intel's by what they can."""
    said = dict(re.findall(r"^(vendor_id|cpu family)\s*:\s*(\w+)", processor, re.MULTILINE))
    vendor, family = said.get("vendor_id"), int(said.get("cpu family", 0))
    return vendor == "GenuineIntel" or (vendor == "AuthenticAMD" and family <= 25)


def _function(library: Path) -> Callable[..., Any] | None:
    values = symbol_values(library, (ANCHOR, READER))
    if len(values) < 2:
        return None
    anchor = ctypes.cast(getattr(ctypes.PyDLL(str(library)), ANCHOR), ctypes.c_void_p).value or 0
    address = anchor - values[ANCHOR] + values[READER]
    kept = code(library, values[READER])
    if not kept or in_memory(address, len(kept)) != kept:  # the file was replaced after it was loaded
        return None
    kind = ctypes.CFUNCTYPE(None, ctypes.c_int, ctypes.POINTER(ctypes.c_char_p), ctypes.c_char_p)
    return kind(address)


def code(library: Path, value: int) -> bytes:
    """The first bytes of a function in an ELF library's file; none where no loaded and executable segment has it."""
    with library.open("rb") as stream:
        head = stream.read(64)
        (start,), (size, count) = struct.unpack_from("<Q", head, 0x20), struct.unpack_from("<HH", head, 0x36)
        stream.seek(start)
        segments = stream.read(size * count)
        for k in range(count):
            kind, flags, offset, begin, _, length = struct.unpack_from("<IIQQQQ", segments, k * size)
            if kind == _LOADED and flags & _EXECUTABLE and begin <= value <= begin + length - COMPARED:
                stream.seek(offset + value - begin)
                return stream.read(COMPARED)
    return b""


def in_memory(address: int, length: int) -> bytes:
    """What lies there in this process; nothing where nothing does."""
    try:
        with Path("/proc/self/mem").open("rb", buffering=0) as memory:
            memory.seek(address)
            return memory.read(length)
    except (OSError, OverflowError, ValueError):
        return b""


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
                place_of = data.find(b"\0" + name.encode() + b"\0", begin, end) + 1
                rows = np.flatnonzero(place == place_of - begin) if place_of else ()
                if len(rows):
                    values[name] = int(value[rows[0]])
    return values
