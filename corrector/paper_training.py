"""Training of the paper's network: autoencoder 1 on simulated clouds, 2 on measured ones, then the LSTM between."""

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from corrector.paper import FRAMES, LENGTH, OUTPUT_POINTS, Autoencoder, NextCode, chamfer_squared, drawn, to_unit
from fabdesign.nouns.array import Floats
from fabdesign.output import atomic_file
from fabdesign.runtime.store import read_kept
from fabdesign.units import in_mm

_MM2 = in_mm(LENGTH) ** 2  # mm^2 in the square of the network's unit
_VALIDATED = 0.1  # share that early stopping looks at


@dataclass(frozen=True)
class PaperTraining:
    """How the paper's network is trained; the defaults are the paper's."""

    points: int = OUTPUT_POINTS  # of a cloud that the encoders see
    targets: int = OUTPUT_POINTS  # of a cloud that an autoencoder's answer is compared with
    code: int = 1024
    every: int = 1  # of how many frames one is shown to the autoencoders in an epoch
    epochs: tuple[int, int] = (1000, 1000)  # at most: of an autoencoder, of the LSTM
    rates: tuple[float, float] = (1e-3, 1e-5)  # of Adam
    patience: tuple[int, int] = (10, 30)  # epochs without a gain
    min_delta: float = 0.1  # mm^2 of an autoencoder; of the LSTM that share of a percent of its first loss
    batch: int = 16
    seed: int = 0

    @staticmethod
    def here(seed: int) -> "PaperTraining":
        """Return full size where there is a GPU; else one for two cores, which rig_a takes within an hour."""
        if torch.cuda.is_available():
            return PaperTraining(seed=seed)
        return PaperTraining(512, 256, code=128, every=6, epochs=(60, 60), rates=(1e-3, 1e-3), seed=seed)


@dataclass(frozen=True, eq=False)
class TrainingPairs:
    """The pairs of one trial: simulated and measured clouds of the same T frames."""

    simulated: Floats  # (T, n, 3) m
    measured: Sequence[Floats]  # T of (n_t, 3) m
    learned: NDArray[np.bool_]  # (T,) which are learned from: all, or with the paper's split, by frames, some


def train_paper(
    trials: Sequence[TrainingPairs],
    plan: PaperTraining,
    folder: Path,
    *,
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> dict[str, NDArray[np.float32]]:
    """Return the weights. Checkpoints lie in `folder`, as paper-PART.pt; what is there is gone on from."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    rng = np.random.default_rng(plan.seed)
    checks = max(round(_VALIDATED * len(trials)), 1) if len(trials) > 1 else 0
    check = set(rng.permutation(len(trials))[:checks].tolist())
    torch.manual_seed(plan.seed)
    parts = {"simulated": Autoencoder(plan.code).to(device), "measured": Autoencoder(plan.code).to(device)}
    for name, network in parts.items():
        clouds = [
            [np.asarray(c, dtype=np.float32) for c, use in zip(getattr(trial, name), trial.learned, strict=True) if use]
            for trial in trials
        ]
        learned = [c for i, trial in enumerate(clouds) for c in trial if i not in check]
        checked = [c for i, trial in enumerate(clouds) for c in trial[:: plan.every] if i in check]

        def loss(network: nn.Module, rows: NDArray[np.intp], from_: list[Floats], rng: np.random.Generator) -> Tensor:
            shown = np.stack([drawn(from_[i], plan.points, rng) for i in rows])
            goal = np.stack([drawn(from_[i], plan.targets, rng) for i in rows])
            clouds = [torch.from_numpy(to_unit(x)).to(device) for x in (shown, goal)]
            return _MM2 * chamfer_squared(network(clouds[0]), clouds[1])

        _descend(name, network, loss, (learned, checked), plan, folder, progress)
    drawing = np.random.default_rng(plan.seed)
    pairs = [_sequences(trial, parts, plan.points, drawing, device) for trial in trials]
    following = NextCode(plan.code).to(device)
    seen = [pair for i, trial in enumerate(pairs) for pair in trial if i not in check]
    looked_at = [pair for i, trial in enumerate(pairs) for pair in trial if i in check]

    def apart(network: nn.Module, rows: NDArray[np.intp], from_: list[Any], rng: np.random.Generator) -> Tensor:
        before, after = (torch.stack([from_[i][k] for i in rows]) for k in (0, 1))
        return (network(before) - after).norm(dim=1).mean()

    _descend("following", following, apart, (seen, looked_at), plan, folder, progress)
    networks = {**parts, "following": following}
    return {
        f"{name}.{key}": value.detach().cpu().numpy().astype(np.float32)
        for name, part in networks.items()
        for key, value in part.state_dict().items()
    }


def _read_state(file: Path) -> dict[str, Any]:
    try:
        state: dict[str, Any] = torch.load(file, weights_only=True)
    except (RuntimeError, pickle.UnpicklingError, IndexError, AttributeError) as error:  # torch's, of a damaged file
        raise ValueError(" ".join(str(error).split())[:80]) from None
    return state


def _descend(
    name: str,
    network: nn.Module,
    loss: Callable[..., Tensor],
    rows: tuple[list[Any], list[Any]],
    plan: PaperTraining,
    folder: Path,
    progress: Callable[[str, int, int], None],
) -> None:
    """Train a network by Adam with early stopping; it ends as it was at its best. rows: learned from, and looked at for
    that."""
    (learned, checked), stage = rows, int(name == "following")  # 0: an autoencoder
    file = folder / f"paper-{name}.pt"
    optimizer = torch.optim.Adam(network.parameters(), lr=plan.rates[stage])
    epochs, every = plan.epochs[stage], plan.every if stage == 0 else 1
    state: dict[str, Any] = {"epoch": 0, "waited": 0, "best": float("inf"), "kept": network.state_dict()}
    if (kept := read_kept(file, _read_state, f"the training of {name}")) is not None:
        state = kept
        network.load_state_dict(state["network"])
        optimizer.load_state_dict(state["optimizer"])
    while state["epoch"] < epochs and state["waited"] < plan.patience[stage]:
        rng = np.random.default_rng([plan.seed, stage, state["epoch"]])
        torch.manual_seed(int(rng.integers(2**31)))
        network.train()
        order = rng.permutation(len(learned))[::every]
        for k in range(0, len(order), plan.batch):
            step = loss(network, order[k : k + plan.batch], learned, rng)
            optimizer.zero_grad()
            step.backward()
            optimizer.step()
        network.eval()
        look = checked or learned[:32]
        with torch.no_grad():
            parts = np.array_split(np.arange(len(look)), -(-len(look) // 32))
            fixed = np.random.default_rng(plan.seed)
            value = float(np.mean([float(loss(network, part, look, fixed)) for part in parts]))
        least = plan.min_delta if stage == 0 else 1e-3 * plan.min_delta
        better = value < state["best"] - least
        state["waited"] = 0 if better else state["waited"] + 1
        if value < state["best"]:
            state["kept"] = {k: v.detach().clone() for k, v in network.state_dict().items()}
        state["best"] = min(value, state["best"])
        state["epoch"] += 1
        saved = state | {"network": network.state_dict(), "optimizer": optimizer.state_dict()}
        with atomic_file(file) as temporary:
            torch.save(saved, temporary)
        unit = "mm^2" if stage == 0 else "of the codes"
        progress(f"paper, {name}, {value:.3g} {unit}, epoch", state["epoch"], epochs)
    network.load_state_dict(state["kept"])
    network.eval()


def _sequences(
    trial: TrainingPairs, parts: dict[str, Autoencoder], points: int, rng: np.random.Generator, device: torch.device
) -> list[tuple[Tensor, Tensor]]:
    """Return the codes (FRAMES, code) of the simulated frames before each frame from the sixth on that is learned from,
    and that frame's own measured code."""
    codes = []
    with torch.no_grad():
        for name, part in parts.items():
            clouds = np.stack([drawn(np.asarray(cloud), points, rng) for cloud in getattr(trial, name)])
            pieces = torch.from_numpy(to_unit(clouds)).to(device).split(16)
            codes.append(torch.cat([part.encode(piece) for piece in pieces]))
    simulated, measured = codes
    return [(simulated[k - FRAMES : k], measured[k]) for k in range(FRAMES, len(measured)) if trial.learned[k]]
