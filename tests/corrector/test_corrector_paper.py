"""The paper's network: trained small, it answers with clouds from the sixth frame on."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from corrector.field import load_corrector
from fabdesign.errors import InputError
from fabdesign.files.measurement_set import read_set
from fabdesign.files.model_file import read_model
from fabdesign.geometry.distances import chamfer
from fabdesign.nouns.forward import Case, with_history
from fabdesign.nouns.model import Model
from tests.corrector.test_corrector import LEARNED, Bending, Stopped, measure, program

TIMES = np.arange(1, 9) / 20


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("torch", reason="training needs the extra corrector")
    return measure(tmp_path_factory.mktemp("paper") / "set", LEARNED[:1], trials=4, times=TIMES)


def small():
    from corrector.paper_training import PaperTraining

    return PaperTraining(points=64, targets=64, code=8, epochs=(12, 3), rates=(3e-3, 1e-3), batch=4)


def _train(measured: Path, output: Path, **options):
    from studies.training.data import TrainingOptions
    from studies.training.train import train_on

    given = {"plan": small(), "network": "paper"} | options
    how = {name: given.pop(name) for name in ("force", "progress") if name in given}
    return train_on([read_set(measured)], Bending(), output, TrainingOptions(Model(), **given), goes_to=output, **how)


def test_the_answer_is_a_cloud_from_the_sixth_frame_on(measured: Path, tmp_path: Path) -> None:
    result = _train(measured, tmp_path / "m.toml")
    corrector = load_corrector(read_model(tmp_path / "m.toml"))
    assert not corrector.ordered
    case = Case(LEARNED[0], program([150, 250]))
    wanted, where = with_history(TIMES, corrector.history())
    motion = Bending().motions([case], [wanted])[0]
    answer = corrector.correct([case], [TIMES], [motion])[0]
    assert answer.shape == (len(TIMES), 3362, 3)
    assert answer[:5].tobytes() == motion[where[0, :5]].tobytes()
    assert (answer[5:] != motion[where[0, 5:]]).any(axis=(1, 2)).all()
    # trained for seconds it is where the cloth is, not more: an untrained one is 0.2 m off
    assert all(chamfer(cloud, frame) < 0.1 for cloud, frame in zip(answer[5:], motion[where[0, 5:]], strict=True))
    (of,) = result.held_out.values()
    assert of.closed.surface is None
    assert np.isfinite(of.after.chamfer)
    assert "surface_rms" not in result.to_json()["held_out"]["two"]["after"]


def test_a_training_that_was_stopped_ends_the_same(measured: Path, tmp_path: Path) -> None:
    plan = replace(small(), epochs=(3, 2))
    uninterrupted = _train(measured, tmp_path / "whole.toml", plan=plan)

    def stop(what: str, done: int, total: int) -> None:
        if "measured" in what and done == 2:
            raise Stopped

    with pytest.raises(Stopped):
        _train(measured, tmp_path / "again.toml", plan=plan, progress=stop)
    again = _train(measured, tmp_path / "again.toml", plan=plan)
    first, second = (load_corrector(r.model).measured.state_dict() for r in (uninterrupted, again))
    assert all(np.array_equal(first[name], second[name]) for name in first)


@pytest.mark.parametrize(("have", "count"), [(9, 4), (4, 4), (4, 9), (4, 11)])
def test_as_many_points_are_drawn_as_are_asked_for(have: int, count: int) -> None:
    pytest.importorskip("torch")
    from corrector.paper import drawn

    points = np.arange(3.0 * have).reshape(have, 3)
    got = drawn(points, count, np.random.default_rng(0))
    _, times = np.unique(got[:, 0], return_counts=True)
    assert got.shape == (count, 3) and {*map(tuple, got)} <= {*map(tuple, points)}
    assert len(times) == min(have, count), "each at least once, or at most once"


def test_frames_must_be_evenly_spaced(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    uneven = measure(tmp_path / "set", LEARNED[:1], trials=2, times=np.array([0.1, 0.2, 0.4, 0.5, 0.6, 0.7]))
    with pytest.raises(InputError, match="evenly"):
        _train(uneven, tmp_path / "m.toml")
    assert not (tmp_path / "m.toml").exists()


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_chamfer_loss_and_its_gradient_are_those_of_all_pairs(device: str) -> None:
    torch = pytest.importorskip("torch", reason="training needs the extra corrector")
    from corrector.paper import chamfer_squared

    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("no GPU here")
    rng = np.random.default_rng(3)
    one, other = (torch.tensor(rng.normal(size=(2, n, 3)), requires_grad=True, device=device) for n in (7, 5))
    apart = (one[:, :, None] - other[:, None]).square().sum(dim=3)
    slow = (apart.amin(dim=2).mean(dim=1) + apart.amin(dim=1).mean(dim=1)).mean()
    fast = chamfer_squared(one, other)
    assert fast.item() == pytest.approx(slow.item(), rel=1e-9)
    for mine, right in zip(
        torch.autograd.grad(fast, (one, other)), torch.autograd.grad(slow, (one, other)), strict=True
    ):
        np.testing.assert_allclose(mine.cpu(), right.cpu(), rtol=1e-6, atol=1e-12)
