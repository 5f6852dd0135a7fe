"""Column headings as laboratories write them: a name and a unit, as in `pressure_kpa`, `Druck [bar]` or `force / N`."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Literal

Dimension = Literal["pressure", "force", "length", "time", "ratio", "tension", "voltage"]


@dataclass(frozen=True)
class Unit:
    dimension: Dimension
    factor: Decimal  # to Pa, N, m, s, 1, N/m, V


def _units(dimension: Dimension, **factors: str) -> dict[str, Unit]:
    return {symbol: Unit(dimension, Decimal(factor)) for symbol, factor in factors.items()}


# as written; where the case does not matter, in lower case
UNITS: Mapping[str, Unit] = {
    **_units("pressure", kPa="1e3", kpa="1e3", Pa="1", pa="1", hPa="100", hpa="100", MPa="1e6", mpa="1e6", bar="1e5"),
    **_units("pressure", mbar="100", barg="1e5", psi="6894.757293168", psig="6894.757293168"),
    **_units("force", N="1", n="1", kN="1e3", kn="1e3", mN="1e-3", lbf="4.4482216152605", kgf="9.80665"),
    **_units("length", m="1", mm="1e-3", cm="1e-2", um="1e-6", **{"µm": "1e-6", "in": "0.0254", "inch": "0.0254"}),
    **_units("time", s="1", sec="1", ms="1e-3", us="1e-6", min="60", µs="1e-6"),
    **_units("ratio", percent="1e-2", pct="1e-2", **{"%": "1e-2", "-": "1", "1": "1", "m/m": "1", "mm/mm": "1"}),
    **_units("voltage", V="1", v="1", mV="1e-3", mv="1e-3", volt="1", volts="1"),
    **_units("tension", **{"n_per_m": "1", "N/m": "1", "n/m": "1", "N/mm": "1e3", "n/mm": "1e3", "kN/m": "1e3"}),
}
_AS_WRITTEN = {"MN", "mPa"}  # another thing than their lower case
WORDS: Mapping[str, tuple[str, ...]] = {
    "time": ("time", "t", "zeit", "temps", "tiempo"),
    "pressure": ("pressure", "p", "druck", "gauge_pressure", "pression", "presion", "pressure_measured", "istdruck"),
    "pressure_command": ("pressure_command", "pressure_set", "set_point", "setpoint", "set_pressure", "solldruck"),
    "contraction": ("contraction", "kontraktion", "contraction_ratio", "verkürzung", "contraccion"),
    "force": ("force", "f", "kraft", "tension", "zugkraft", "fuerza"),
    "load": ("load", "last"),
    "displacement": ("displacement", "extension", "weg", "verschiebung", "hub", "déplacement"),
    "stretch": ("stretch", "streckung"),
    "strain": ("strain", "dehnung"),
    "length": ("length", "länge", "longitud", "longueur"),
    "tension": ("tension",),
}
DIMENSIONS: Mapping[str, Dimension] = {
    **dict.fromkeys(("pressure", "pressure_command", "pressure_amplitude", "channel"), "pressure"),
    "force": "force",
    "load": "force",
    "displacement": "length",
    "length": "length",
    "time": "time",
    "tension": "tension",
    **dict.fromkeys(("contraction", "stretch", "strain"), "ratio"),
}
_CHANNEL = re.compile(r"(?:channel|kanal|canal|ch|valve|ventil)_?(\d+)")
# of a pressure, which files have as gauge pressure
_ABSOLUTE = re.compile(r"(?:^|[\W_])p?abs(?:ol\w*)?(?:[\W_]|\d|$)")
_VACUUM = re.compile(r"vacuum|vakuum|unterdruck|suction|below_atm")
_NUMBERED = re.compile(r"\D*?_?(\d+)")
_BRACKETED = re.compile(r"(.*?)[\s_]*[\[(]([^\[\]()]*)[\])]\s*$")
_SLASHED = re.compile(r"(.*\S)\s+/\s+(\S+)\s*$")
_LAST_WORD = re.compile(r"(.*\S)[\s_]+(\S+)$")
_IN = re.compile(r"\s+in$")


@dataclass(frozen=True)
class Heading:
    text: str  # as it stands in the file
    name: str  # without unit, in lower case, words joined by _
    symbol: str | None  # of the unit

    @property
    def unit(self) -> Unit | None:
        return None if self.symbol is None else unit_of(self.symbol)

    @property
    def quantity(self) -> str | None:
        """Return the quantity by the name and, of a name of several, the unit: `pressure`, `channel_0`, ..."""
        if matched := _CHANNEL.fullmatch(self.name):
            return f"channel_{int(matched[1])}"
        unit = self.unit
        fitting = (q for q, words in WORDS.items() if self.name in words)
        return next((q for q in fitting if unit is None or unit.dimension == DIMENSIONS[q]), None)

    @property
    def is_absolute(self) -> bool:
        """Return whether a pressure is named an absolute one, above vacuum."""
        return _ABSOLUTE.search(self.name) is not None

    @property
    def is_vacuum(self) -> bool:
        """Return whether a pressure is named one below the atmosphere's, whose sign is the other one."""
        return _VACUUM.search(self.name) is not None

    @property
    def number(self) -> int | None:
        """Return the number at the end of its name, as in `p1` or `muscle 3`."""
        matched = _NUMBERED.fullmatch(self.name)
        return None if matched is None else int(matched[1][:9])


def dimension_of(quantity: str) -> Dimension:
    """Return the dimension of `pressure`, `channel_0`, ..."""
    return DIMENSIONS[quantity.rstrip("0123456789").rstrip("_")]


def without_unit(text: str, dimension: Dimension) -> str:
    """Return what is said of a heading that lacks its unit."""
    example = next(symbol for symbol, unit in UNITS.items() if unit.dimension == dimension)
    return f"{text} has no unit; write it in the heading, such as {text} [{example}]"


def unit_of(symbol: str) -> Unit | None:
    symbol = symbol.strip()
    if symbol in _AS_WRITTEN:
        return None
    return UNITS.get(symbol) or UNITS.get(symbol.lower())


def parse_heading(text: str) -> Heading:
    """Return the name, and the unit where one is written: in brackets, after a slash, or as the last word."""
    text = text.strip().strip('"').strip()
    if text.lower().endswith("_n_per_m"):
        return Heading(text, _plain(text[: -len("_n_per_m")]), "n_per_m")
    if matched := _BRACKETED.match(text):
        return Heading(text, _plain(matched[1]), matched[2].strip() or "-")
    for pattern in (_SLASHED, _LAST_WORD):
        matched = pattern.match(text)
        if matched and not matched[2].isdecimal() and unit_of(matched[2]) is not None:
            return Heading(text, _plain(_IN.sub("", matched[1])), matched[2])
    return Heading(text, _plain(text), None)


def parse_units_row(cells: list[str]) -> list[str] | None:
    """Return the symbols in a row of units below the header ("psi", "[%]", nothing); None where it is no such row."""
    symbols = [cell.strip().strip('"').strip("[]() ") for cell in cells]
    known = [unit_of(symbol) is not None and not symbol.isdecimal() for symbol in symbols]
    return symbols if any(known) and all(k or not s for k, s in zip(known, symbols, strict=True)) else None


def _plain(name: str) -> str:
    return re.sub(r"[\s_\-]+", "_", name.strip().lower()).strip("_")
