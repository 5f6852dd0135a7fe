"""The exceptions that a user is meant to read, and notes on what was read."""

import numbers
import re
import sys
import warnings
from typing import Any

# the extra of pyproject.toml that brings a module
EXTRAS = {
    "open3d": "clouds",
    "ezdxf": "dxf",
    "torch": "corrector",
    "pygltflib": "export",
    "meshio": "export",
    "rerun": "rerun",
    "pandas": "tables",
    "pyarrow": "tables",
    "optuna": "optuna",
    "viser": "studio",
    "imageio_ffmpeg": "video",
    "distributed": "cluster",
    "xarray": "tables",
    "c3d": "mocap",
    "cv2": "board",
    "rosbags": "realsense",
    "mcap": "ros",
    "mcap_ros2": "ros",
}


# what would command a terminal, break a line or turn the order of letters, or is no letter; not tabs and ends of lines
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def printable(text: str) -> str:
    """Return a text with such characters as escapes: names in files of others may hold them."""
    return CONTROL.sub(lambda matched: ascii(matched[0])[1:-1], text)


class InputError(ValueError):
    """Bad input, said in one line: what came, where, and what was expected. The command line exits with 2."""


class SimulationError(RuntimeError):
    """Sound input whose motion could not be computed, said in one line. The command line exits with 1."""


class InputNote(UserWarning):
    """A line on what was left out of a file, or read otherwise than as the format has it."""


def note(line: str) -> None:
    """Say a line of what was read as an `InputNote`: Python shows it as a warning, the command line as "note: ..."."""
    warnings.warn(InputNote(line), stacklevel=2)


def require_number(
    name: str, value: Any, least: float, most: float, *, kind: type[float] = float, unit: str = ""
) -> None:
    """Raise InputError where an option is no number of that range."""
    number = isinstance(value, numbers.Integral if kind is int else numbers.Real) and not isinstance(value, bool)
    if not number or not least <= value <= most:
        integer = " whole" if kind is int else ""
        raise InputError(f"{name} is {value!r}; expected a{integer} number from {least:g} to {most:g}{unit}")


def why_not_loaded(error: ImportError) -> str:
    """Return what to do about a package that is there and does not load, after a semicolon; nothing where that is not
    known: a bare machine lacks a library, or a file of the user is loaded in place of a module."""
    import sysconfig

    if "libX11" in str(error):
        return "; on Debian: apt install libx11-6"
    name = (error.name or "").partition(".")[0]
    if name not in sys.stdlib_module_names or (file := getattr(sys.modules.get(name), "__file__", None)) is None:
        return ""
    standard = file.startswith(sysconfig.get_path("stdlib"))
    return "" if standard else f"; {file} is loaded in place of Python's {name}: expected another name"


def needs(error: ModuleNotFoundError) -> str:
    """Return what to install for a module that is missing, in a clause."""
    extra = EXTRAS.get((error.name or "").partition(".")[0])
    package = error.name if extra is None else f"'fabdesign[{extra}]'"
    return f"needs {error.name}; install it with: pip install {package}"
