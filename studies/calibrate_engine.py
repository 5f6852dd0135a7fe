"""What one engine's parameters mean in another: the part of a calibration's error that no data of one engine shows."""

from collections.abc import Mapping

ENGINE_DIFFERENCE: Mapping[str, float] = {}
