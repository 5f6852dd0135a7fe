"""This module cuts the cloth out of a depth image: by a box, planes, colours, or nearness to the predicted cloth."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from fabdesign.formats.schema import ABOVE_0, Metre
from fabdesign.formats.table import Table
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric

Triple = tuple[float, float, float]
_BESIDE, _ABOVE, _AHEAD = 0.05, 0.02, 0.75  # m, m, and of the cloth's longer side: as far as a cloth reaches


@dataclass(frozen=True)
class Cut:
    """The cloth's place and colour; what is absent cuts nothing, but for the box."""

    box: Annotated[tuple[Triple, Triple] | None, "two corners, m in the world; absent: as far as the cloth reaches"] = (
        None
    )
    planes: Annotated[tuple[tuple[float, float, float, float], ...], "a, b, c, d: kept is a x + b y + c z >= d, m"] = ()
    colour: Annotated[
        tuple[Triple, Triple] | None, "hue [degrees], saturation, value: from, to; a hue may go on over 360"
    ] = None
    predicted: Annotated[Metre | None, ABOVE_0, "kept is what lies so near to the cloth as it is simulated"] = None

    def resolved(self, table: Table) -> "Cut":
        """Raise InputError for a box without inside and colours out of range."""
        if self.box is not None and not all(a < b for a, b in zip(*self.box, strict=True)):
            raise table.bad("box", "the lower corner, then the upper one")
        if self.colour is not None:
            (h0, *low), (h1, *high) = self.colour
            if not (0 <= h0 < h1 <= 720 and all(0 <= a <= b <= 1 for a, b in zip(low, high, strict=True))):
                raise table.bad("colour", "[hue 0 to 360, saturation 0 to 1, value 0 to 1], from and to")
        return self

    def corners(self, fabric: Fabric) -> Array:
        """Return (2, 3) m, the box's corners."""
        if self.box is not None:
            return np.array(self.box)
        ahead = _AHEAD * max(fabric.width, fabric.height)
        half = fabric.width / 2 + _BESIDE
        return np.array([[-half, -fabric.height - _BESIDE, -ahead], [half, _ABOVE, ahead]])


NO_CUT = Cut()


def of_colour(image: NDArray[np.uint8], colour: tuple[Triple, Triple]) -> NDArray[np.bool_]:
    """Return (rows, columns) whether a pixel (.., 3) of red, green and blue lies in the range."""
    rgb = image.astype(np.float64) / 255.0
    value, least = rgb.max(axis=-1), rgb.min(axis=-1)
    spread = value - least
    safe = np.where(spread > 0, spread, 1.0)
    r, g, b = np.moveaxis(rgb, -1, 0)
    hue = np.select([value == r, value == g], [((g - b) / safe) % 6, (b - r) / safe + 2], (r - g) / safe + 4) * 60
    saturation = spread / np.where(value > 0, value, 1.0)
    (h0, s0, v0), (h1, s1, v1) = colour
    in_hue = ((hue >= h0) & (hue <= h1)) | ((hue + 360 >= h0) & (hue + 360 <= h1))
    return np.asarray(in_hue & (saturation >= s0) & (saturation <= s1) & (value >= v0) & (value <= v1))
