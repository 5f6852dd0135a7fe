"""The seed paper's network (Peng et al. 2022): two PointNet autoencoders and an LSTM from the codes of simulated frames
to the code of the next measured one. In PyTorch, for training and for prediction.

Where the paper gives no widths they are PointNet's (Qi et al. 2017): 64, 64, 64, 128 and the code, for every point.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor, nn

from corrector.inputs import described, distance
from fabdesign.nouns.array import Floats
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import SIDE, Case, Trust, with_history

FRAMES = 5  # whose codes the LSTM takes
OUTPUT_POINTS = 2 * SIDE * SIDE
LENGTH = 0.1  # m, that the network takes for one
_CENTRE = (0.0, -0.1, 0.0)  # m
_WIDTHS = (64, 64, 64, 128)
_DROPOUT = 0.05


class Autoencoder(nn.Module):
    """Clouds (B, n, 3) in units of LENGTH to codes (B, code), and back to clouds (B, OUTPUT_POINTS, 3)."""

    def __init__(self, code: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for a, b in pairwise((3, *_WIDTHS, code)):
            layers += [nn.Linear(a, b), nn.ReLU()]
        self.points = nn.Sequential(*layers[:-1])
        self.decoder = nn.Sequential(
            nn.Linear(code, code), nn.ReLU(), nn.Dropout(_DROPOUT), nn.Linear(code, 3 * OUTPUT_POINTS)
        )

    def encode(self, cloud: Tensor) -> Tensor:
        """Return (B, code): the largest of every feature over the points, in whatever order they are."""
        return self.points(cloud).amax(dim=1)

    def decode(self, code: Tensor) -> Tensor:
        return self.decoder(code).reshape(len(code), OUTPUT_POINTS, 3)

    def forward(self, cloud: Tensor) -> Tensor:
        return self.decode(self.encode(cloud))


class NextCode(nn.Module):
    """Codes (B, FRAMES, code) of simulated frames to the next measured frame's (B, code)."""

    def __init__(self, code: int) -> None:
        super().__init__()
        self.memory = nn.LSTM(code, code, batch_first=True)
        self.last = nn.Linear(code, code)

    def forward(self, codes: Tensor) -> Tensor:
        out, _ = self.memory(codes)
        return self.last(out[:, -1])


def to_unit(points: Floats) -> NDArray[np.float32]:
    """Return coordinates [m] as the network takes them."""
    return ((np.asarray(points) - _CENTRE) / LENGTH).astype(np.float32)


def drawn(points: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Return (count, 3): of the points (n, 3) each at most once, or where they are fewer, all, and some of them
    again."""
    if len(points) > count:
        return points[rng.choice(len(points), count, replace=False)]
    return np.concatenate([points, points[rng.choice(len(points), count - len(points))]])  # a batch is of one size


def chamfer_squared(one: Tensor, other: Tensor) -> Tensor:
    """Return the mean over the batch of both mean squared nearest distances, summed, in the points' unit squared."""

    def off(points: Tensor, others: Tensor) -> Tensor:
        index = _nearest(points.detach(), others.detach())[:, :, None].expand(-1, -1, 3)
        return (points - others.gather(1, index)).square().sum(dim=2).mean(dim=1)

    return (off(one, other) + off(other, one)).mean()


def _nearest(points: Tensor, others: Tensor) -> Tensor:
    """Return (B, n): of each point (B, n, 3) the nearest of the others. The gradient of the distance needs no other
    pair."""
    if points.device.type == "cuda":
        return torch.cdist(points, others).argmin(dim=2)
    trees = [cKDTree(cloud) for cloud in others.numpy()]
    return torch.from_numpy(np.stack([tree.query(cloud)[1] for tree, cloud in zip(trees, points.numpy(), strict=True)]))


@dataclass(frozen=True, eq=False)
class PaperCorrector:
    """Implements fabdesign.nouns.forward.Corrector; the answer is an unordered cloud from the sixth frame on, the
    simulator's points before. It has no limit of trust, as the paper has none."""

    simulated: Autoencoder
    following: NextCode
    measured: Autoencoder
    frame_rate: float  # Hz, of the motions learned from
    points: int  # of a cloud that the encoder sees
    known: Sequence[Mapping[str, Any]]
    ordered: bool = False

    @staticmethod
    def of(weights: Mapping[str, NDArray[np.float32]], about: Mapping[str, Any]) -> "PaperCorrector":
        code = int(about["code"])
        parts = {"simulated": Autoencoder(code), "following": NextCode(code), "measured": Autoencoder(code)}
        for name, part in parts.items():
            tensors = {k.removeprefix(f"{name}."): v for k, v in weights.items() if k.startswith(f"{name}.")}
            part.load_state_dict({k: torch.from_numpy(np.array(v)) for k, v in tensors.items()})
            part.eval()
        return PaperCorrector(
            **parts,  # type: ignore[arg-type]
            frame_rate=float(about["frame_rate"]),
            points=int(about["points"]),
            known=list(about["known"]),
        )

    @property
    def starts(self) -> float:
        """Return s, from which on it answers."""
        return (FRAMES + 0.5) / self.frame_rate

    def history(self) -> tuple[float, ...]:
        return tuple(k / self.frame_rate for k in range(FRAMES, 0, -1))

    def trust(self, design: Design) -> Trust:
        return Trust(distance(described(design), self.known), float("inf"))

    def correct(
        self, cases: Sequence[Case], times: Sequence[NDArray[np.float64]], motions: Sequence[Floats]
    ) -> list[NDArray[np.float32]]:
        """See fabdesign.nouns.forward.Corrector."""
        return [self._correct(t, motion) for t, motion in zip(times, motions, strict=True)]

    def _correct(self, times: NDArray[np.float64], motion: Floats) -> NDArray[np.float32]:
        _, where = with_history(times, self.history())
        answer = np.array(motion[where[0]], dtype=np.float32)
        sound = np.asarray(np.isfinite(motion).all(axis=(1, 2)))
        known = np.flatnonzero(sound[where].all(axis=0) & (times > self.starts))
        if not len(known):
            return answer
        rng = np.random.default_rng(0)
        used = np.unique(where[1:, known])
        place = np.searchsorted(used, where[1:, known].T)
        with torch.no_grad():
            seen = np.stack([drawn(motion[k], self.points, rng) for k in used])
            codes = torch.cat([self.simulated.encode(part) for part in torch.from_numpy(to_unit(seen)).split(16)])
            clouds = self.measured.decode(self.following(codes[torch.from_numpy(place)])).numpy()
        answer[known] = clouds * np.float32(LENGTH) + np.array(_CENTRE, dtype=np.float32)
        return answer
