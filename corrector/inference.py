"""The field network in numpy, so that a prediction needs no PyTorch (`corrector.network`)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from corrector.inputs import CHANNELS, TURNED_CHANNELS
from corrector.outputs import LOCAL_SCALE, SWING_SCALE, TURNED, TURNED_SIGNS

Array = NDArray[np.float32]
Floats = NDArray[np.floating[Any]]

_BLOCK = ("first.weight", "first.bias", "common.weight", "common.bias", "second.weight", "second.bias")


def outputs_of(weights: Mapping[str, Array], dilations: tuple[int, ...], inputs: Array) -> tuple[Array, Array]:
    """(B, LOCAL, n, n) and (B, SWINGS) of inputs (B, channels, n, n), as `network.FieldNetwork` gives them."""
    extra = np.arange(CHANNELS, inputs.shape[1])
    over = np.swapaxes(inputs[:, np.concatenate([TURNED_CHANNELS, extra])], 2, 3)
    local, hidden = _once(weights, dilations, inputs)
    other, _ = _once(weights, dilations, over)
    other = np.swapaxes(other, 1, 2)[..., TURNED] * TURNED_SIGNS
    mean = (local + other) / 2 * LOCAL_SCALE
    swings = (hidden.mean(axis=(1, 2)) @ weights["swing.weight"].T + weights["swing.bias"]) * SWING_SCALE
    return np.moveaxis(mean, -1, 1).astype(np.float32), swings.astype(np.float32)


def _once(weights: Mapping[str, Array], dilations: tuple[int, ...], inputs: Array) -> tuple[Floats, Floats]:
    """Channels last."""
    x: Floats = np.moveaxis(inputs, 1, -1) * weights["scale"]
    x = x @ weights["enter.weight"][:, :, 0, 0].T + weights["enter.bias"]
    for k, dilation in enumerate(dilations):
        own = {name: weights[f"blocks.{k}.{name}"] for name in _BLOCK}
        y = convolve(silu(x), own["first.weight"], own["first.bias"], dilation)
        y += (x.mean(axis=(1, 2)) @ own["common.weight"].T + own["common.bias"])[:, None, None]
        x = x + convolve(silu(y), own["second.weight"], own["second.bias"], 1)
    x = silu(x)
    return x @ weights["local.weight"][:, :, 0, 0].T + weights["local.bias"], x


def convolve(x: Floats, weight: Array, bias: Array, dilation: int) -> Floats:
    """(B, n, m, out) of x (B, n, m, in), weight (out, in, 3, 3) and zeros around the grid."""
    rows, cols = x.shape[1:3]
    padded = np.pad(x, ((0, 0), (dilation, dilation), (dilation, dilation), (0, 0)))
    y = np.zeros((*x.shape[:3], len(bias)), dtype=np.float32) + bias
    for i in range(3):
        for j in range(3):
            shifted = padded[:, i * dilation : i * dilation + rows, j * dilation : j * dilation + cols]
            y += shifted @ weight[:, :, i, j].T
    return y


def silu(x: Floats) -> Floats:
    return np.asarray(x / (1 + np.exp(-np.clip(x, -80, None))), dtype=np.float32)
