"""The studio over a target that moves: knots of a program, the motion that goes on from them, what is saved."""

import contextlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fabdesign.errors import InputError
from fabdesign.files.design_file import write_design
from fabdesign.files.pressure_file import read_csv, write_pressures
from fabdesign.formats.json_file import write_json
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.forward import Case
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.output import write_mark
from studies.studio.opening import open_files
from studies.studio.session import Session
from tests.bending import AtOnce, bow, widget

DESIGN = build("cross", muscles=2)
CYCLE = 0.05  # s, of the usual regulator
RAMP = np.linspace(0, 150e3, 20)  # Pa, of channel 0 in the motion that is wanted, which ends at 1 s


class Bowing:
    """In the place of Resumed: each frame is the shape of the set point before it."""

    def __init__(self, simulator: object) -> None:
        pass

    def motion(self, case: Case, times: np.ndarray) -> np.ndarray:
        rows = case.program.at(times - 1e-6)
        return np.array([shape(replace(case, program=PressureProgram(np.zeros(1), row[None], 1.0))) for row in rows])


def shape(case: Case) -> np.ndarray:
    """(2 n, 3) m of both faces."""
    return np.concatenate([(bow(case) + np.float32([0, 0, z])).reshape(-1, 3) for z in (1e-3, -1e-3)])


def program(channel_0: np.ndarray) -> PressureProgram:
    rows = np.stack([channel_0, np.zeros_like(channel_0)], axis=1)
    return PressureProgram(CYCLE * np.arange(len(rows)), rows, CYCLE * len(rows))


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study whose target bows as under RAMP: a cloud each 0.1 s from rest on."""
    monkeypatch.setattr("studies.studio.solver.Resumed", Bowing)
    write_design(DESIGN, tmp_path / "cross.toml")
    (tmp_path / "clouds").mkdir()
    at_rest = Bowing(None).motion(Case(DESIGN, program(RAMP * 0)), np.zeros(1))
    motion = Bowing(None).motion(Case(DESIGN, program(RAMP)), 0.1 * np.arange(1, 11))
    for k, points in enumerate([*at_rest, *motion]):
        np.savetxt(tmp_path / "clouds" / f"{k:02d}.xyz", points[::12])
    head = 'format = "fabdesign.study/1"\nkind = "follow"\ndesign = "cross.toml"\n'
    path = tmp_path / "follow.toml"
    path.write_text(f'{head}[motion]\nfile = "clouds"\nframe_rate = 10\n[rig_limits]\nrate = 1000\n')
    return path


def sitting(*files: Path) -> tuple[Session, AtOnce]:
    """A session that has opened files, with a simulator that costs nothing; its first motion is there."""
    worker = AtOnce()
    session = Session(open_files(files, None), worker)
    session.begin(lambda: None)
    settle(session)
    return session, worker


def settle(session: Session) -> None:
    for _ in range(12):
        session.tick()


def mean(session: Session) -> float:
    """mm from the target, over the motion."""
    assert session.program is not None
    assert session.program.off is not None
    return 1e3 * float(np.nanmean(session.program.off))


def test_a_knot_takes_the_set_points_beside_it_along(study: Path) -> None:
    session, _ = sitting(study)
    edit = session.program
    assert edit is not None
    assert edit.knots.tolist() == list(range(0, 20, 2))  # each 0.1 s
    edit.select(0, 4)
    edit.put(40e3)
    assert edit.pressures[6:11].tolist() == [[0, 0], [20e3, 0], [40e3, 0], [20e3, 0], [0, 0]]
    edit.select(1, 9)
    edit.put(40e3)
    assert edit.pressures[16:, 1].tolist() == [0, 20e3, 40e3, 40e3]  # to the end
    edit.select(0, 4)
    edit.put(200e3)  # 1,000 kPa/s: not more than 49.9 kPa a cycle, from rest on
    assert np.abs(np.diff(edit.pressures[:, 0], prepend=0)).max() <= 50e3
    assert 50e3 < edit.pressure < 100e3
    edit.take(edit.moving.pressures)
    assert not edit.pressures.any()


def test_motion_and_error_follow_a_knot(study: Path) -> None:
    session, worker = sitting(study)
    edit, playing = session.program, session.playing
    assert edit is not None
    assert playing.motion is not None
    assert np.isfinite(edit.off).sum() == 10 < len(playing.motion.times)  # clouds are 0.1 s apart, frames 1/30 s
    before, points = mean(session), playing.motion.points
    playing.scrub(20)
    for knot, pressure in enumerate(RAMP[::2]):
        edit.select(0, knot)
        edit.put(pressure)
    settle(session)
    assert mean(session) < 0.3 * before
    assert playing.motion.points is not points
    assert playing.frame == 20  # where it was
    assert "mm, mean" in playing.motion.in_words(20)
    asked = [ask for ask in worker.asked if ask.kind == "program"]
    assert len(asked) == 3  # the first one, the first knot, and all that came meanwhile
    session.document.edit("flip", lambda layout: layout.with_pressure(0, 1e3))
    assert playing.motion is None  # it was of other pressures
    edit.play("motion")
    settle(session)
    assert (worker.asked[-1].kind, worker.asked[-1].wanted) == ("motion", edit.moving.wanted)


def test_a_program_is_saved_and_opened_again(study: Path, tmp_path: Path) -> None:
    session, _ = sitting(study)
    edit = session.program
    assert edit is not None
    edit.select(0, 5)
    edit.put(30e3)
    edit.save(tmp_path / "edited.csv")
    saved = read_csv(tmp_path / "edited.csv")
    assert saved.duration == pytest.approx(1.0)
    assert saved.at(CYCLE * np.arange(20)) == pytest.approx(edit.pressures)
    with pytest.raises(InputError, match=r"edited\.csv"):
        edit.save(tmp_path / "edited.csv")  # it is there already, and stays
    again, _ = sitting(study, tmp_path / "edited.csv")
    assert again.program is not None
    assert again.program.pressures.tolist() == edit.pressures.tolist()


def test_the_folder_of_a_result_is_opened(study: Path, tmp_path: Path) -> None:
    folder = tmp_path / "result"
    folder.mkdir()
    write_json(folder / "result.json", {"study": "../follow.toml"})
    write_pressures(program(np.round(RAMP, -2)), folder / "pressures.csv")
    write_mark(folder, "follow", ["result.json", "pressures.csv"])
    session, _ = sitting(folder)
    assert session.program is not None
    assert session.program.pressures[:, 0] == pytest.approx(np.round(RAMP, -2))
    assert mean(session) < 0.5  # mm
    write_json(folder / "result.json", {"study": None})
    with pytest.raises(InputError, match="of a study without a file"):
        open_files([folder], None)


def test_the_page_shows_knots_that_are_dragged(study: Path) -> None:
    pytest.importorskip("viser")
    from studies.studio.server import Gate, quiet_viser
    from studies.studio.widgets.page import Page

    with contextlib.closing(Gate("127.0.0.1", None)) as gate, quiet_viser(gate) as server:
        page = Page(server, open_files([study], None), AtOnce())
        turns = iter(range(20))
        page.run(lambda: next(turns) == 12)
        edit = page.session.program
        assert edit is not None
        assert [server.scene.get_handle_by_name(f"/program/knot_{k}") is not None for k in (9, 10)] == [True, False]
        assert "<polyline" in widget(page, "Motion", "Program", "error").handle.content
        ball = np.array(server.scene.get_handle_by_name("/program/knot_6").position)
        goal = ball + [0.0, 0.02, 0.0]
        camera = SimpleNamespace(position=goal + [0.01, 0.02, 0.5])
        for phase in ("start", "update", "end"):
            event = SimpleNamespace(client=SimpleNamespace(camera=camera), end_position=goal, phase=phase)
            page.nodes.drag("/program/knot_6", event)
        for _ in range(12):
            page.turn()
        assert edit.knot == 6
        moved = np.array(server.scene.get_handle_by_name("/program/knot_6").position)
        assert moved == pytest.approx(goal, abs=3e-4)  # whole tenths of a kPa
        assert widget(page, "Motion", "Program", "Pressure, kPa").handle.value == pytest.approx(edit.pressure / 1e3)
        page.session.end()


def test_a_motion_goes_on_from_the_state_before_what_changed() -> None:
    """As from rest but for the rounding of single precision, with the simulator itself."""
    from sim import Simulator
    from studies.studio.solver import Resumed

    simulator, times = Simulator(11), 0.05 * np.arange(1, 7)
    rows = np.array([[50e3, 0], [90e3, 10e3], [90e3, 60e3], [20e3, 60e3], [20e3, 0], [70e3, 0]], float)
    resumed, changed = Resumed(simulator), rows.copy()
    first = resumed.motion(Case(DESIGN, PressureProgram(CYCLE * np.arange(6), rows, 0.3)), times)
    changed[3] = [80e3, 5e3]
    case = Case(DESIGN, PressureProgram(CYCLE * np.arange(6), changed, 0.3))
    again = resumed.motion(case, times)
    assert resumed.first == 3
    assert np.array_equal(again[:3], first[:3])
    assert np.abs(again[3:] - first[3:]).max() > 1e-4
    [expected] = simulator.motions([case], [times])
    assert np.abs(again - expected).max() < 1e-7
    assert np.array_equal(resumed.motion(replace(case, order=1), times), expected)
    assert resumed.first == 0  # another case
