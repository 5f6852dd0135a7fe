"""The cloth: an elastic orthotropic sheet, by its declared (data sheet) values."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

from fabdesign.files.law_tables import MembraneCurve, read_membrane_curve
from fabdesign.formats.schema import ABOVE_0, FROM_0, FileUnit, Key, Metre
from fabdesign.formats.table import Table

Edge = Literal["top", "bottom", "left", "right", "none"]
LARGEST = 10.0  # m; a cloth beyond it was surely meant in millimetres
SWING = 8.0  # rad/s, of a hung cloth
_SLACK = 1e-9  # m, of rounding that a point on the border may have


def _pair(value: float | tuple[float, float], table: Table) -> tuple[float, float] | None:
    """Return [across, down], or one number for both, as two numbers; None unless they are above 0."""
    pair = value if isinstance(value, tuple) else (value, value)
    return pair if min(pair) > 0 else None


def _initial_stiffness(table: Table) -> tuple[float, float]:
    """Return the slope at small strain of a curve that replaces both stiffnesses."""
    curve: MembraneCurve | None = table.decoded.get("membrane_curve")
    if curve is None or not all(curve.strain):
        raise table.missing("membrane_stiffness")
    slopes = [(t[1] - t[0]) / (s[1] - s[0]) for s, t in zip(curve.strain, curve.tension, strict=True)]
    return slopes[0], slopes[1]


_EXPECTED = "a number above 0, or two of them [across, down]"
_PAIR = Key(form=Annotated[float | tuple[float, float], Key(expected=_EXPECTED)], read=_pair, expected=_EXPECTED)


_OR_CURVE = replace(_PAIR, absent=_initial_stiffness)
_CURVE = Key(file=read_membrane_curve)


@dataclass(frozen=True)
class Fabric:
    """A rectangle of cloth, how it is held and what pulls on it.

    Direction 1 is across (u), 2 is down (v). `poisson` is nu_12; nu_21 = nu_12 k_2 / k_1. Membrane stiffness is
    uniaxial tension per strain with free sides, bending stiffness moment per width over curvature of a strip with free
    sides, shear stiffness tension per engineering shear angle, twist stiffness twist moment over twist curvature
    (None: B / (1 + nu)).
    """

    width: Annotated[Metre, ABOVE_0, "across"]
    height: Annotated[Metre, ABOVE_0, "down"]
    thickness: Annotated[Metre, ABOVE_0]
    areal_density: Annotated[float, FileUnit("kg/m^2"), ABOVE_0, "without muscles"]
    membrane_stiffness: Annotated[tuple[float, float], FileUnit("N/m"), _OR_CURVE, "across and down"]
    shear_stiffness: Annotated[float, FileUnit("N/m"), ABOVE_0]
    poisson: Annotated[float, "nu_12"]
    bending_stiffness: Annotated[tuple[float, float], FileUnit("N m"), _PAIR, "across and down"]
    twist_stiffness: Annotated[float | None, FileUnit("N m"), FROM_0] = None
    viscosity: Annotated[float, FileUnit("N s/m"), FROM_0, "membrane"] = 0.0
    air_damping: Annotated[float, FileUnit("N s/m^3"), FROM_0] = 0.0
    support: Annotated[Literal["pinned", "clamped"], "pinned is free to turn, clamped is not"] = "pinned"
    hung: Annotated[Edge | tuple[tuple[float, float], ...], "an edge, none, or (u, v) points in m"] = "top"
    gravity: Annotated[tuple[float, float, float], FileUnit("m/s^2")] = (0.0, -9.81, 0.0)
    membrane_curve: Annotated[MembraneCurve | None, _CURVE, "N/m over strain, in place of the stiffness"] = None

    def resolved(self, table: Table) -> "Fabric":
        """Raise InputError for millimetres, an impossible Poisson's ratio, and points that are not on the cloth."""
        for key, size in (("width", self.width), ("height", self.height)):
            if size > LARGEST:
                raise table.bad(key, "metres (is it in millimetres?)")
        # nu_12 nu_21 = nu_12^2 k_2 / k_1 < 1, or stretching the cloth would give energy
        k_1, k_2 = self.membrane_stiffness
        if self.poisson**2 * k_2 >= k_1:
            raise table.bad("poisson", f"nu_12 below sqrt(k_1 / k_2) = {(k_1 / k_2) ** 0.5:.3g}")
        if not self.hung:
            raise table.bad("hung", "a list of [u, v] points in m")
        for i, point in enumerate(self.hung if isinstance(self.hung, tuple) else ()):
            self.require_inside(point, table, f"hung[{i}]")
        return self

    def require_inside(self, point: tuple[float, float], table: Table, key: str) -> None:
        """Raise InputError for a point (u, v) [m] that is not on the cloth."""
        for axis, value, size in (("u", point[0], self.width), ("v", point[1], self.height)):
            if not -_SLACK <= value <= size + _SLACK:
                hint = " (is it in millimetres?)" if value > 20 * size else ""
                raise table.error(f"{key}: {axis} = {value:g} m lies outside the cloth, 0 to {size:g} m{hint}")
