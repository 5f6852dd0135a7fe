"""Three devices that make Taichi compile sooner or better code, and what turns each off (docs/compiler.md)."""

import os

import taichi

from fabdesign.errors import InputError

TESTED = (1, 7, 4)  # the version of Taichi whose insides they know
WIDE_VECTORS = "FABDESIGN_WIDE_VECTORS"  # sim/kernels/vector_width.py
SHORT_FRONTEND = "FABDESIGN_SHORT_FRONTEND"  # sim/kernels/frontend.py
HIDDEN_STEPS = "FABDESIGN_HIDDEN_STEPS"  # sim/kernels/fields.py


def wanted(device: str) -> bool:
    """Whether the environment variable of that name leaves the device on: not where it is 0. Raises InputError."""
    given = os.environ.get(device, "1")
    if given not in {"0", "1"}:
        raise InputError(f"{device} is {given!r}; expected 0 or 1")
    return given == "1"


def tested() -> bool:
    """Whether this is the Taichi that is known; others are left as they are."""
    return taichi.__version__ == TESTED
