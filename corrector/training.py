"""Training of the field network: PyTorch, two cores or fewer, in minutes; goes on where it was stopped."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from corrector.cloth import Cloth
from corrector.examples import Examples
from corrector.inputs import CHANNELS, TURNED_CHANNELS, exchanged, mirrored
from corrector.layout import NODES
from corrector.network import DILATIONS, EXTRA, FieldNetwork
from corrector.outputs import LOCAL_SCALE, LOCAL_U, LOCAL_Z, SWINGS_U, SWINGS_Z
from corrector.response import slopes_of
from corrector.shape import FINE, integration, refinement
from fabdesign.output import whole_file

_LINEAR = 5e-3  # m: larger residuals count by their size, not its square; strays and coin tosses do not decide
_NOISE = 0.3e-3  # m: a frame that is this close is done
# mm, weights of the mean squares of the local outputs in units of their scale: normals hardly show strain and turns
_SMALL = (0.01, 0.01, 0.01, 0.3, 0.3, 0.3)
_CLIP = 1.0  # largest norm of a step's gradient
_LEAST_SCALE = 0.02  # an input that hardly varies is not blown up
_SPAN = 0.15  # of the steps until the rate is at its height


@dataclass(frozen=True)
class Training:
    """How the field network is trained."""

    epochs: int = 60
    batch: int = 32  # frames
    rate: float = 3e-3  # of AdamW, at its height (one cycle: Smith and Topin 2018)
    decay: float = 1e-2
    width: int = 32
    dilations: tuple[int, ...] = DILATIONS
    rematch: tuple[float, ...] = (0.35, 0.7)  # shares of the epochs after which clouds are matched again
    seed: int = 0


class Trainer:
    """A network on its way."""

    def __init__(self, examples: Examples, cloth: Cloth, plan: Training) -> None:
        self.examples, self.plan, self.epoch, self.cloth = examples, plan, 0, cloth
        torch.manual_seed(plan.seed)
        self.network = FieldNetwork(plan.width, plan.dilations)
        spread = np.maximum(examples.inputs.std(axis=(0, 2, 3)), _LEAST_SCALE)
        scale = 1 / spread
        self.network.scale[:CHANNELS] = torch.from_numpy((scale + scale[TURNED_CHANNELS]) / 2)
        self.batches = max(len(examples) // plan.batch, 1)
        self.optimizer = torch.optim.AdamW(self.network.parameters(), lr=plan.rate, weight_decay=plan.decay)
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(
            self.optimizer, plan.rate, total_steps=plan.epochs * self.batches, pct_start=_SPAN
        )
        fabric = cloth.fabric
        matrices = (
            slopes_of(fabric, cloth.ratio, FINE),
            integration(fabric.width, fabric.height, fabric.hung, FINE),
        )
        self._slopes, self._integration = (torch.from_numpy(matrix.astype(np.float32)) for matrix in matrices)

    def run_epoch(self) -> float:
        """One pass over all examples in an order of its own; the mean loss in mm. Draws depend on seed and epoch alone,
        so that a training that goes on later ends the same."""
        rng = np.random.default_rng([self.plan.seed, self.epoch])
        torch.manual_seed(int(rng.integers(2**31)))
        self.network.train()
        order, total = rng.permutation(len(self.examples)), 0.0
        for k in range(self.batches):
            rows = order[k * self.plan.batch : (k + 1) * self.plan.batch]
            left_right, front_back = (bool(x) for x in rng.random(2) < 0.5)
            loss = self._loss(self.examples.rows(np.sort(rows)), left_right, front_back)
            self.optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), _CLIP)
            self.optimizer.step()
            self.schedule.step()
            total += float(loss.detach())
        self.epoch += 1
        return total / self.batches

    def _loss(self, batch: Examples, left_right: bool, front_back: bool) -> Tensor:
        local, swings = outputs_of(self.network, batch.inputs, left_right=left_right, front_back=front_back)
        moved = displacement(local, swings, batch, self._slopes, self._integration)
        residual = torch.from_numpy(batch.goal) - (torch.from_numpy(batch.along) * moved).sum(dim=-1)
        size = residual.abs()
        squared = torch.where(size < _LINEAR, size**2, 2 * _LINEAR * size - _LINEAR**2)
        weight = torch.from_numpy(batch.weight)
        frames = (squared * weight).sum(dim=(1, 2)) / weight.sum(dim=(1, 2)).clamp(min=1) + _NOISE**2
        size_of = local / torch.from_numpy(LOCAL_SCALE)[:, None, None]
        return 1e3 * frames.sqrt().mean() + torch.square(size_of).mean(dim=(0, 2, 3)) @ torch.tensor(_SMALL)

    def displacements(self, examples: Examples) -> NDArray[np.float32]:
        """(B, FINE, FINE, 3) m."""
        self.network.eval()
        parts = []
        with torch.no_grad():
            for k in range(0, len(examples), 64):
                batch = examples.rows(slice(k, k + 64))
                outputs = outputs_of(self.network, batch.inputs)
                parts.append(displacement(*outputs, batch, self._slopes, self._integration).numpy())
        return np.concatenate(parts)

    def set_arrays(self, weights: Mapping[str, NDArray[np.float32]]) -> None:
        """Take the weights that `FieldNetwork.arrays` gave."""
        self.network.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in weights.items()})

    def save(self, path: Path) -> None:
        """A checkpoint, whole."""
        state = {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "schedule": self.schedule.state_dict(),
            "epoch": self.epoch,
        }
        with whole_file(path) as temporary:
            torch.save(state, temporary)

    def load(self, path: Path) -> None:
        """Go on from a checkpoint of the same plan and examples."""
        state: dict[str, Any] = torch.load(path, weights_only=True)
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.schedule.load_state_dict(state["schedule"])
        self.epoch = int(state["epoch"])


def train_field(
    examples: Examples,
    cloth: Cloth,
    plan: Training,
    *,
    checkpoint: Path | None = None,
    rematch: Callable[[NDArray[np.float32]], Examples] | None = None,
    progress: Callable[[int, int, float], None] = lambda done, total, loss: None,
) -> dict[str, NDArray[np.float32]]:
    """The weights of a network trained by `plan`.

    checkpoint: a file that is written after every epoch, and gone on from where it is there. rematch: the examples
    with their clouds matched to surfaces moved by (B, FINE, FINE, 3) m. progress: told epochs done, in all, and the
    mean loss [mm].
    """
    trainer = Trainer(examples, cloth, plan)
    if checkpoint is not None and checkpoint.is_file():
        trainer.load(checkpoint)
    at = [round(share * plan.epochs) for share in plan.rematch]
    if rematch is not None and any(epoch < trainer.epoch for epoch in at):
        trainer.examples = _matched_at(trainer, checkpoint, rematch)
    while trainer.epoch < plan.epochs:
        if rematch is not None and trainer.epoch in at:
            if checkpoint is not None:
                trainer.save(_matching_checkpoint(checkpoint))
            trainer.examples = rematch(trainer.displacements(examples))
        loss = trainer.run_epoch()
        if checkpoint is not None:
            trainer.save(checkpoint)
        progress(trainer.epoch, plan.epochs, loss)
    return trainer.network.arrays()


def _matching_checkpoint(checkpoint: Path) -> Path:
    return checkpoint.with_name(f"{checkpoint.stem}-matched{checkpoint.suffix}")


def _matched_at(
    trainer: Trainer, checkpoint: Path | None, rematch: Callable[[NDArray[np.float32]], Examples]
) -> Examples:
    """The examples as they were last matched: by the network of that moment."""
    assert checkpoint is not None
    then = Trainer(trainer.examples, trainer.cloth, trainer.plan)
    then.load(_matching_checkpoint(checkpoint))
    return rematch(then.displacements(trainer.examples))


def outputs_of(
    network: FieldNetwork, inputs: NDArray[np.float32], *, left_right: bool = False, front_back: bool = False
) -> tuple[Tensor, Tensor]:
    """(B, LOCAL, n, n) and (B, SWINGS) of inputs (B, CHANNELS, n, n), by way of the mirrored cloth where that is asked
    for."""
    if left_right:
        inputs = mirrored(inputs)
    if front_back:
        inputs = exchanged(inputs)
    local, swings = network(torch.from_numpy(with_signs(inputs, left_right=left_right, front_back=front_back)))
    if front_back:
        local, swings = local * torch.from_numpy(LOCAL_Z)[:, None, None], swings * torch.from_numpy(SWINGS_Z)
    if left_right:
        local = local.flip(-1) * torch.from_numpy(LOCAL_U)[:, None, None]
        swings = swings * torch.from_numpy(SWINGS_U)
    return local, swings


def with_signs(
    inputs: NDArray[np.float32], *, left_right: bool = False, front_back: bool = False
) -> NDArray[np.float32]:
    """(B, CHANNELS + EXTRA, n, n): told whether they are mirrored. What a rig does that has no mirror image (a cloth
    with a curl of its own, a sensor off its place) is then learned as such."""
    signs = np.array([-1 if left_right else 1, -1 if front_back else 1], dtype=np.float32)
    extra = np.broadcast_to(signs[:, None, None], (len(inputs), EXTRA, *inputs.shape[2:]))
    return np.concatenate([inputs, extra], axis=1)


def displacement(local: Tensor, swings: Tensor, batch: Examples, slope: Tensor, integrate: Tensor) -> Tensor:
    """(B, FINE, FINE, 3) m: `outputs.displacement_of` for PyTorch."""
    line = torch.from_numpy(refinement(NODES, FINE).astype(np.float32))
    fine = torch.einsum("ai,bkij,cj->bkac", line, local, line)
    frames = len(fine)
    tilts = (fine[:, :3].reshape(frames, -1) @ slope.T).reshape(frames, 2, FINE, FINE)
    swing = swings[:, 0, None, None] + swings[:, 1, None, None] * torch.linspace(-1, 1, FINE)
    tilt_u, tilt_v = tilts[:, 0, ..., None], (tilts[:, 1] + swing)[..., None]
    strain_u, strain_v, turn = (fine[:, 3 + k, ..., None] for k in range(3))
    across, down, normal = (torch.from_numpy(x) for x in (batch.across, batch.down, batch.normal))
    size_u, size_v = across.norm(dim=-1, keepdim=True), down.norm(dim=-1, keepdim=True)
    unit_u, unit_v = across / size_u, down / size_v
    change_u = size_u * (tilt_u.sin() * normal + (tilt_u.cos() - 1 + strain_u) * unit_u + turn * unit_v)
    change_v = size_v * (tilt_v.sin() * normal + (tilt_v.cos() - 1 + strain_v) * unit_v - turn * unit_u)
    steps_u = (change_u[:, :, 1:] + change_u[:, :, :-1]) / 2
    steps_v = (change_v[:, 1:] + change_v[:, :-1]) / 2
    steps = torch.cat([steps_u.reshape(frames, -1, 3), steps_v.reshape(frames, -1, 3)], dim=1)
    return (integrate @ steps).reshape(frames, FINE, FINE, 3)
