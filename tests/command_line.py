"""Running the program in this process, on sound files, with a simulator that costs nothing."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from fabdesign.cli import main
from fabdesign.files.design_file import write_design
from fabdesign.files.measurement_set import NewTrial, TrialData, write_set
from fabdesign.files.model_file import write_model
from fabdesign.nouns.catalogue import build, standard
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model, Parameter

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `fabdesign ARGUMENTS...`: exit code, standard output, standard error."""

    monkeypatch.setenv("FABDESIGN_LANES", "8")  # as the simulator of this process has them

    def call(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["fabdesign", *map(str, arguments)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        out, err = capsys.readouterr()
        return code, out, err

    return call


class Hanging:
    """A forward model whose cloth stays at rest; it notes what it was asked."""

    asked: list[Case] = []  # noqa: RUF012
    options: dict[str, object] = {}  # noqa: RUF012
    side = 0
    made: set[int] = set()  # noqa: RUF012

    def __init__(self, points_per_side: int = 41, **options: object) -> None:
        Hanging.side, Hanging.options = points_per_side, options
        Hanging.made.add(points_per_side)

    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        Hanging.asked = list(cases)
        u, v = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, -0.2, 41))
        faces = [np.stack([u, v, np.full_like(u, z)], axis=-1).reshape(-1, 3) for z in (1e-3, -1e-3)]
        return [np.tile(np.concatenate(faces).astype(np.float32), (len(t), 1, 1)) for t in times]

    def equilibria(self, cases: Sequence[Case]) -> list[np.ndarray]:
        return [motion[0] for motion in self.motions(cases, [np.zeros(1)] * len(cases))]


class Diverging(Hanging):
    def motions(self, cases: Sequence[Case], times: Sequence[np.ndarray]) -> list[np.ndarray]:
        motions = super().motions(cases, times)
        motions[-1][1:] = np.nan
        return motions


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> type[Hanging]:
    monkeypatch.setattr("sim.Simulator", Hanging, raising=False)
    return Hanging


def write_sound(folder: Path) -> None:
    """A design, a model, a pressure table and a set, all sound."""
    write_design(build("cross"), folder / "cross.toml")
    write_design(standard(), folder / "bare.toml")
    write_model(Model({"membrane": Parameter(1.1, (1.0, 1.2))}), folder / "model.toml")
    (folder / "p.csv").write_text("time_s,channel_0,channel_1\n0,100,0\n0.5,200,50\n")
    cloud = np.random.default_rng(1).integers([-1000, -2000, 0], [1001, 1, 2], (400, 3)) * 1e-4
    cloud[:, 2] = np.where(cloud[:, 2] > 0, 1e-3, -1e-3)  # on one of the faces of the cloth at rest
    trials = [
        NewTrial(
            f"{i:03}", "cross", i, "fit", TrialData(np.array([0.1, 0.2]), np.full((2, 2), 1e5 * i), (cloud, cloud))
        )
        for i in range(3)
    ]
    write_set(folder / "set", {"cross": build("cross")}, trials, name="x")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Sound files."""
    write_sound(tmp_path)
    return tmp_path


def one_line(result: tuple[int, str, str], problem: str) -> None:
    code, out, err = result
    assert code == 2, err
    assert out == ""
    assert len(err.splitlines()) == 1
    assert problem in err
