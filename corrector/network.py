"""The field network in PyTorch: a small residual convolutional network on the coarse grid, the same weights everywhere.

`corrector.inference` computes the same in numpy.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from corrector.inputs import CHANNELS, TURNED_CHANNELS
from corrector.outputs import LOCAL, LOCAL_SCALE, SWING_SCALE, SWINGS, TURNED, TURNED_SIGNS

DILATIONS = (1, 1)
EXTRA = 2  # inputs that say whether the cloth was mirrored left to right, and front to back: 1 or -1


class Block(nn.Module):
    """Two 3 x 3 convolutions around a residual connection; the mean over the cloth is added in between, so that what
    hangs on all of it (a supply that droops) is known everywhere."""

    def __init__(self, width: int, dilation: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation)
        self.common = nn.Linear(width, width)
        self.second = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        """(B, width, n, n) to the same."""
        y = self.first(nn.functional.silu(x)) + self.common(x.mean(dim=(2, 3)))[:, :, None, None]
        return x + self.second(nn.functional.silu(y))


class FieldNetwork(nn.Module):
    """Inputs (B, CHANNELS + EXTRA, n, n) to outputs (B, LOCAL, n, n) and (B, SWINGS) of `corrector.outputs`.

    The local ones are the mean of what the network says of the cloth and of the cloth turned over its diagonal: a
    muscle does across what it does down. The last layers start at zero: an untrained network corrects nothing.
    """

    scale: Tensor

    def __init__(self, width: int = 32, dilations: Sequence[int] = DILATIONS) -> None:
        super().__init__()
        self.register_buffer("scale", torch.ones(CHANNELS + EXTRA))
        self.enter = nn.Conv2d(CHANNELS + EXTRA, width, 1)
        self.blocks = nn.ModuleList(Block(width, dilation) for dilation in dilations)
        self.local = nn.Conv2d(width, LOCAL, 1)
        self.swing = nn.Linear(width, SWINGS)
        for parameter in (*self.local.parameters(), *self.swing.parameters()):
            nn.init.zeros_(parameter)
        order = np.concatenate([TURNED_CHANNELS, CHANNELS + np.arange(EXTRA)])
        self._turned = torch.from_numpy(order), torch.from_numpy(TURNED), torch.from_numpy(TURNED_SIGNS)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        inputs, order, signs = self._turned
        local, hidden = self._once(x)
        over, _ = self._once(x[:, inputs].transpose(2, 3))
        local = (local + over.transpose(2, 3)[:, order] * signs[:, None, None]) / 2
        swings = self.swing(hidden.mean(dim=(2, 3)))
        return local * torch.from_numpy(LOCAL_SCALE)[:, None, None], swings * torch.from_numpy(SWING_SCALE)

    def _once(self, x: Tensor) -> tuple[Tensor, Tensor]:
        x = self.enter(x * self.scale[:, None, None])
        for block in self.blocks:
            x = block(x)
        x = nn.functional.silu(x)
        return self.local(x), x

    def arrays(self) -> dict[str, np.ndarray]:
        """All weights, float32."""
        return {name: value.detach().cpu().numpy().astype(np.float32) for name, value in self.state_dict().items()}
