"""The studio without a browser: layouts, their limits, snapping, the shape that follows, files."""

import contextlib
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fabdesign.drawings.sewing import Sewing, export_design
from fabdesign.effects.registry import EFFECTS
from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.pressure_file import constant_program, read_pressures
from fabdesign.geometry.surface import Surface, capped_rms
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import Case, Trust, with_history
from fabdesign.nouns.model import NORMAL90, Covariance, EffectTerm, Model, Parameter, Quantity
from fabdesign.nouns.predictor import Predictor
from fabdesign.study_files.study_file import read_study
from fabdesign.study_files.study_targets import TargetFile
from optimize.search.margins import Limits, constraint_margins
from studies.check.files import inspect
from studies.layout_search.target import LoadedTarget, load_target
from studies.studio import layout as edits
from studies.studio.drawings import DrawingHistory, LiveShape, Result
from studies.studio.layout import Layout, broken_limits, row_distance, rows, snapped
from studies.studio.model_choice import ModelChoice, half_band
from studies.studio.opening import Comparison, Opened, open_files, search_limits
from studies.studio.search import Search, study_document
from studies.studio.session import Session
from studies.studio.shapes import JumpDetector
from studies.studio.solver import Ask, StudioSolver
from studies.studio.widgets.declared import on_plane
from studies.studio.widgets.flat_view import Places, laced, ribbon
from studies.studio.widgets.panels import model
from studies.studio.widgets.status import errors_table, results_table
from tests.bending import AtOnce, Bending, bow, widget
from tests.command_line import Run, one_line

BASIC = Layout.of(build("basic"))


class Shown:
    """A page that notes what it is to show."""

    def __init__(self) -> None:
        self.session: Session | None = None
        self.shapes: list[LiveShape] = []
        self.messages: list[str] = []
        self.motions = 0
        self._motion: object = None

    def __call__(self) -> None:
        assert self.session is not None
        shape, motion, (message, _) = (
            self.session.shapes.shown, self.session.playing.motion, self.session.document.message
        )  # fmt: skip
        if shape is not None and shape not in self.shapes[-1:]:
            self.shapes.append(shape)
        if message not in ("", *self.messages[-1:]):
            self.messages.append(message)
        if motion is not None and motion is not self._motion:
            self.motions += 1
        self._motion = motion


def begun(opened: Opened, clock: "Clock") -> tuple[Session, Shown, AtOnce]:
    """A session that has begun, with a page and a simulator that cost nothing."""
    worker, shown = AtOnce(), Shown()
    shown.session = session = Session(opened, worker, clock=clock)
    session.begin(shown)
    return session, shown, worker


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


Begin = Callable[..., tuple[Session, Shown, AtOnce, Clock]]


@pytest.fixture
def begin(tmp_path: Path) -> Begin:
    """A session on `basic.toml` in an empty folder, with a page and a simulator that cost nothing."""

    def make(**changes: object) -> tuple[Session, Shown, AtOnce, Clock]:
        file = tmp_path / "basic.toml"
        if not file.exists():
            write_design(build("basic"), file)
        design = read_design(file)
        opened = replace(Opened(file, Layout.of(design), search_limits(design)), **changes)
        clock = Clock()
        return *begun(opened, clock), clock

    return make


def settle(session: Session, clock: Clock, seconds: float = 2.0) -> None:
    for _ in range(20):
        clock.now += seconds / 20
        session.tick()


# layouts


def test_a_corner_goes_where_it_is_put_and_not_beyond_the_cloth() -> None:
    moved = edits.move_corner(BASIC, 0, 1, (0.06, 0.3))
    assert moved.design.muscles[0].path == (BASIC.design.muscles[0].path[0], (0.06, 0.2))
    assert moved.design.muscles[1:] == BASIC.design.muscles[1:]
    assert edits.move_corner(BASIC, 0, 1, BASIC.design.muscles[0].path[0]) is BASIC  # no leg of no length


def test_a_whole_muscle_keeps_its_form_at_the_edge() -> None:
    moved = edits.move_muscle(BASIC, 0, (-1.0, 0.004)).design.muscles[0]
    assert moved.path == ((0.0, 0.012), (0.0, 0.196))
    assert moved.length == pytest.approx(BASIC.design.muscles[0].length)


def test_removing_a_muscle_takes_its_channel_along() -> None:
    layout = Layout(BASIC.design, {pose: tuple(by * k for k in range(8)) for pose, by in ((0, 1e3), (1, 1e4))})
    less = edits.remove_muscle(layout, 2)
    assert less.design.channels == 7
    assert less.at(1).pressures == (0, 1e4, 3e4, 4e4, 5e4, 6e4, 7e4)  # in the other pose too
    assert less.pressures == (0, 1e3, 3e3, 4e3, 5e3, 6e3, 7e3)
    assert [m.channel for m in less.design.muscles] == list(range(7))
    shared = edits.set_channel(layout, 3, 2)
    assert edits.remove_muscle(shared, 2).pressures == layout.pressures  # another muscle is still on it


def test_adding_flipping_and_corners() -> None:
    more = edits.add_muscle(BASIC, like=7)
    assert (more.design.channels, more.pressures[-1], more.design.muscles[-1].side) == (9, 0.0, "back")
    assert edits.flip(BASIC, 0).design.muscles[0].side == "back"
    bent = edits.add_corner(BASIC, 0)
    assert bent.design.muscles[0].path[1] == (0.025, 0.1)
    assert edits.remove_corner(bent, 0, 1) == BASIC
    with pytest.raises(InputError, match="two apart"):
        edits.remove_corner(BASIC, 0, 0)
    with pytest.raises(InputError, match="expected 0 to 8"):
        edits.set_channel(BASIC, 0, 10)


def test_every_edit_is_a_design_that_reads_back(tmp_path: Path) -> None:
    layout = edits.add_corner(edits.flip(edits.add_muscle(BASIC), 0), 3)
    layout = edits.move_corner(layout, 3, 1, (0.123456789, 0.1))
    write_design(layout.design, tmp_path / "d.toml")
    assert read_design(tmp_path / "d.toml").muscles == layout.design.muscles


# undo and redo


def test_a_gesture_is_one_step() -> None:
    document = DrawingHistory(BASIC)
    for k in range(5):
        document.shape("drag", edits.move_muscle(BASIC, 0, (0.001 * k, 0.0)))
    document.end()
    dragged = document.layout
    document.do("flip", edits.flip(dragged, 1))
    assert (document.move(-1), document.layout) == ("flip", dragged)
    assert (document.move(-1), document.layout) == ("drag", BASIC)
    assert document.move(-1) is None
    assert (document.move(1), document.layout) == ("drag", dragged)
    document.do("another", BASIC)
    assert document.move(1) is None  # what was undone before is gone


def test_changed_means_other_than_what_was_kept() -> None:
    document = DrawingHistory(BASIC)
    document.do("flip", edits.flip(BASIC, 0))
    assert document.changed
    document.keep()
    assert not document.changed
    document.move(-1)
    assert document.changed


# snapping


def test_points_fall_onto_the_nearest_crossing_of_rows() -> None:
    assert row_distance(BASIC.design) == 0.01
    assert rows(0.05, 0.02).tolist() == pytest.approx([0.02, 0.04])
    rng = np.random.default_rng(0)
    for point in rng.uniform(-0.05, 0.25, (50, 2)):
        at = snapped((float(point[0]), float(point[1])), (0.2, 0.15), 0.02)
        for x, given, length in zip(at, point, (0.2, 0.15), strict=True):
            among = rows(length, 0.02)
            assert abs(x - given) == pytest.approx(np.abs(among - given).min())
            assert 0 < x < length


# limits


def test_limits_light_up_and_go_out_in_words() -> None:
    limits = Limits()
    assert broken_limits(BASIC, limits) == []
    close = edits.move_muscle(BASIC, 0, (0.046, 0.0))
    (line,) = broken_limits(close, limits)
    assert (line.limit, line.muscles) == ("spacing", (0, 1))
    assert line.message == "muscles 0 and 1 lie 4.0 mm apart on the front; expected 6 mm"
    assert broken_limits(edits.flip(close, 0), limits)[0].muscles != (0, 1)
    (edge,) = broken_limits(edits.move_corner(BASIC, 0, 0, (0.002, 0.008)), limits)
    assert edge.message == "muscle 0 lies 2.0 mm from the edge; expected 5 mm"
    (crossing,) = broken_limits(edits.move_corner(BASIC, 0, 0, (0.1, 0.008)), limits)
    assert crossing.limit == "crossing"
    (high,) = broken_limits(BASIC.with_pressure(3, 401e3), limits)
    assert (high.limit, high.channel) == ("pressure", 3)
    assert "channel 3 has 401 kPa; expected 0 to 400 kPa" in high.message


def test_limits_of_a_muscle_type() -> None:
    kind = replace(BASIC.design.muscle_types["EM20"], stock_length=0.2, tail_length=0.02, min_bend_radius=0.2)
    layout = Layout.of(replace(BASIC.design, muscle_types={"EM20": kind}, muscles=BASIC.design.muscles[:1]))
    (stock,) = broken_limits(layout, Limits())
    assert stock.message == "muscle 0 is 184.0 mm long; expected at most 160 mm, the stock of EM20 less its tails"
    sharp = edits.move_corner(edits.add_corner(layout, 0), 0, 1, (0.12, 0.1))
    assert {line.limit for line in broken_limits(sharp, Limits())} == {"stock_length", "min_bend_radius"}


def test_limits_agree_with_the_margins_of_a_search() -> None:
    rng = np.random.default_rng(3)
    names = {"crossing": "spacing", "spacing": "spacing", "shortest": "shortest"}
    for _ in range(40):
        layout = Layout.of(replace(BASIC.design, muscles=BASIC.design.muscles[:3]))
        for i in range(3):
            for corner in range(2):
                layout = edits.move_corner(layout, i, corner, tuple(rng.uniform(0.01, 0.19, 2)))
        margins = constraint_margins(layout.design, np.zeros(3), Limits())
        broken = {names[line.limit] for line in broken_limits(layout, Limits())}
        assert broken == {name for name, margin in margins.items() if margin < -1e-6 and name != "inside_cloth"}


# the shape that follows


def test_only_the_newest_layout_is_asked_and_the_exact_one_after_letting_go(begin: Begin) -> None:
    session, shown, worker, clock = begin()
    settle(session, clock)
    worker.asked.clear()
    earlier = len(shown.shapes)
    layouts = [edits.move_muscle(BASIC, 0, (0.001 * k, 0.0)) for k in range(1, 6)]
    worker.busy = True
    for layout in layouts:  # while the first is out, others come
        session.document.drag("drag", layout)
    worker.busy = False
    session.shapes.turn()
    session.shapes.turn()
    assert [ask.case.design for ask in worker.asked] == [layouts[0].design, layouts[4].design]
    assert {ask.kind for ask in worker.asked} == {"follow"}
    session.document.drag("drag", layouts[4], last=True)
    session.shapes.turn()
    session.shapes.turn()
    assert not session.shapes.waiting
    assert [(s.exact, s.points_per_side) for s in shown.shapes[earlier:]] == [(False, 21), (False, 21), (True, 41)]
    assert shown.shapes[-1].layout is layouts[4]


def test_an_exact_shape_of_a_layout_that_has_changed_is_dropped(begin: Begin) -> None:
    session, shown, worker, _ = begin()
    session.shapes.turn()  # the exact one is out
    worker.busy = True
    session.document.drag("drag", edits.flip(BASIC, 0))
    worker.busy = False
    session.shapes.turn()
    session.shapes.turn()
    assert [ask.kind for ask in worker.asked] == ["follow", "exact", "follow"]
    assert [shape.exact for shape in shown.shapes] == [False, False]


def test_what_cannot_be_computed_is_told(begin: Begin, monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model(effects=(EffectTerm("no_such_effect"),))
    monkeypatch.setattr(ModelChoice, "model", model)
    session, *_ = begin()
    with pytest.raises(InputError, match="no_such_effect"):
        session.shapes.turn()


def test_a_jump_is_told_from_a_motion_that_keeps_pace() -> None:
    jumps, flat = JumpDetector(), np.zeros((2, 9, 3), np.float32)
    shapes = [(edits.move_muscle(BASIC, 0, (0.001 * k, 0)), flat + np.float32(0.0004 * k)) for k in range(6)]
    assert [jumps.of(points, layout, exact=False)[0] for layout, points in shapes] == [None] * 6
    snapped_to = shapes[-1][1] + np.float32(0.02)
    jump, before = jumps.of(snapped_to, edits.move_muscle(BASIC, 0, (0.006, 0)), exact=False)
    assert jump == pytest.approx(0.02 * 3**0.5, rel=1e-3)
    assert before is shapes[-1][1]
    elsewhere = jumps.of(flat, edits.move_muscle(BASIC, 0, (0.006, 0)), exact=True)
    assert elsewhere[0] is not None  # the rise from rest leads to another shape than the one that was followed


# a sitting


def test_a_slider_follows_and_comes_to_rest(begin: Begin) -> None:
    session, shown, _worker, clock = begin()
    settle(session, clock)
    for kilopascals in range(0, 200, 20):
        session.document.press(0, 1e3 * kilopascals)
        clock.now += 0.02
        session.tick()
    assert session.document.history.gesture
    settle(session, clock)
    assert not session.document.history.gesture
    assert shown.shapes[-1].exact
    assert shown.shapes[-1].layout.pressures[0] == 180e3
    session.document.step(-1)
    assert session.document.layout.pressures[0] == 0.0  # the whole way of the slider is one step


def test_dragging_snaps_where_it_is_asked(begin: Begin) -> None:
    session, *_ = begin()
    session.document.drag_corner(0, 0, (0.0312, 0.0149), last=True)
    assert session.document.layout.design.muscles[0].path[0] == (0.0312, 0.0149)
    session.document.snap = True
    session.document.drag_corner(0, 0, (0.0312, 0.0149), last=True)
    assert session.document.layout.design.muscles[0].path[0] == (0.03, 0.01)
    session.document.drag_muscle(0, (0.004, 0.0), last=False)
    session.document.drag_muscle(0, (0.016, 0.0), last=True)
    assert session.document.layout.design.muscles[0].path == ((0.05, 0.01), (0.045, 0.192))
    session.document.drag_corner(99, 0, (0.1, 0.1), last=True)  # gone meanwhile in another tab


def test_unsaved_changes_come_back(begin: Begin) -> None:
    session, _, _, clock = begin()
    session.document.edit("flip", lambda layout: edits.flip(layout, 0))
    session.document.press(1, 120e3)
    settle(session, clock)
    unsaved = session.document.layout
    again, shown, *_ = begin()
    assert again.document.layout == unsaved
    assert "restored" in shown.messages[0]
    again.document.step(-1)
    assert again.document.layout == Layout.of(build("basic"))


def test_an_autosave_on_a_file_that_has_changed_is_a_step_away(begin: Begin, tmp_path: Path) -> None:
    session, _, _, clock = begin()
    session.document.edit("flip", lambda layout: edits.flip(layout, 0))
    settle(session, clock)
    unsaved = session.document.layout
    write_design(edits.remove_muscle(BASIC, 7).design, tmp_path / "basic.toml")
    again, shown, *_ = begin()
    assert len(again.document.layout.design.muscles) == 7
    assert "has changed" in shown.messages[0]
    again.document.step(1)
    assert again.document.layout == unsaved


@pytest.mark.parametrize("text", ["", "{}", '{"format": "fabdesign.studio-autosave/1", "muscles": [{}]}', "[1]"])
def test_a_damaged_autosave_is_none(begin: Begin, tmp_path: Path, text: str) -> None:
    (tmp_path / ".basic.toml.studio").write_text(text)
    session, shown, *_ = begin()
    assert session.document.layout == BASIC
    assert session.document.history.move(-1) is None
    assert session.document.history.move(1) is None
    assert shown.messages == []


def test_a_file_changed_meanwhile_is_taken_or_said(begin: Begin, tmp_path: Path) -> None:
    session, shown, _, clock = begin()
    settle(session, clock)
    write_design(edits.flip(BASIC, 0).design, tmp_path / "basic.toml")
    settle(session, clock)
    assert session.document.layout.design.muscles[0].side == "back"
    session.document.edit("flip", lambda layout: edits.flip(layout, 1))
    mine = session.document.layout
    write_design(edits.remove_muscle(BASIC, 0).design, tmp_path / "basic.toml")
    settle(session, clock)
    assert session.document.layout == mine
    assert "changed by another program" in shown.messages[-1]
    session.files.load_again()
    assert len(session.document.layout.design.muscles) == 7


def test_what_is_saved_passes_check(begin: Begin, tmp_path: Path) -> None:
    session, _shown, *_ = begin()
    session.document.edit("move", lambda layout: edits.move_muscle(layout, 0, (0.01, 0.0)))
    session.document.press(0, 150e3)
    session.files.save(tmp_path / "mine")
    names = {file.relative_to(tmp_path / "mine").as_posix() for file in (tmp_path / "mine").rglob("*")}
    assert {"design.toml", "pressures.csv", "template/design_front.svg", "template/design_cut_list.csv"} <= names
    assert not session.document.history.changed
    design = read_design(tmp_path / "mine" / "design.toml")
    assert design.muscles == session.document.layout.design.muscles
    program = read_pressures(tmp_path / "mine" / "pressures.csv", design)
    assert program.pressure[-1].tolist() == [150e3, *[0.0] * 7]
    assert inspect(tmp_path / "mine" / "design.toml").problems == ()
    again = open_files([tmp_path / "mine" / "design.toml"], None)
    assert again.layout.pressures == session.document.layout.pressures


def test_nothing_is_replaced_unasked(begin: Begin, tmp_path: Path) -> None:
    bare = Layout.of(replace(BASIC.design, muscles=()))  # no templates to draw
    (session, *_), (second, *_) = begin(layout=bare), begin(layout=bare)
    files, folder = session.files, tmp_path / "mine"
    files.save(folder)
    assert files.replaces(folder) is None
    files.save(folder)  # one's own
    assert "earlier design" in str(second.files.replaces(folder))
    with pytest.raises(InputError, match="earlier design"):
        second.files.save(folder)
    (folder / "design.toml").write_text("# by hand\n")
    assert "another program" in str(files.replaces(folder))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        files.save(tmp_path / "other", replace=True)


def test_playing_a_programme_asks_for_a_motion(begin: Begin) -> None:
    session, shown, _worker, clock = begin()
    session.document.press(0, 100e3)
    session.playing.rise()
    settle(session, clock)
    assert shown.motions == 1
    assert session.playing.motion is not None
    assert len(session.playing.motion.points) == len(session.playing.motion.times) == 61
    assert shown.messages[-1] == "rise: 61 frames"  # no longer that it is computed
    session.document.edit("flip", lambda layout: edits.flip(layout, 0))
    assert session.playing.motion is None  # it was of another layout


def test_a_motion_is_written_for_other_programs(begin: Begin, tmp_path: Path) -> None:
    session, shown, _worker, clock = begin()
    with pytest.raises(InputError, match="no motion"):
        session.playing.write(tmp_path / "none.csv")
    session.document.press(0, 100e3)
    session.playing.rise()
    settle(session, clock)
    with pytest.raises(InputError, match=r"expected a name that ends in \.html, \.png, \.glb"):
        session.playing.write(tmp_path / "motion.docx")
    session.playing.write(tmp_path / "motion.csv")
    settle(session, clock)
    rows = (tmp_path / "motion.csv").read_text().splitlines()
    assert len(rows) == 1 + 61
    assert rows[0].startswith("panel,time_s,")
    assert session.playing.motion is not None
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("pygltflib")
    session.playing.write(tmp_path / "motion.glb")
    settle(session, clock)
    scene = trimesh.load(tmp_path / "motion.glb")
    points = np.concatenate([mesh.vertices for mesh in scene.geometry.values()])
    assert np.abs(points[:, 0]).max() == pytest.approx(0.1, abs=2e-3)
    session.playing.write(tmp_path / "motion.csv")
    with pytest.raises(InputError, match=r"motion\.csv"):
        settle(session, clock)  # it is there already, and stays
    assert "wrote" not in shown.messages[-1]


def test_a_set_shows_what_was_measured_beside_its_prediction(folder: Path) -> None:
    opened = open_files([folder / "set"], folder / "model.toml")
    clock = Clock()
    session, _, worker = begun(opened, clock)
    session.playing.trial(list(session.document.trials)[1])
    settle(session, clock)
    assert session.playing.motion is not None
    distances = session.playing.motion.distances(1)
    assert distances is not None
    assert distances.shape == (400,)
    assert "surface RMS" in session.playing.motion.in_words(1)
    assert worker.asked[-1].sensing
    session.end()
    assert not list((folder / "set").glob(".*.studio"))


def test_every_trial_has_its_errors_in_a_table(folder: Path) -> None:
    clock = Clock()
    session, *_ = begun(open_files([folder / "set"], None), clock)
    session.playing.all_errors()
    settle(session, clock, 4.0)
    assert list(session.playing.errors) == list(session.document.trials)
    shown = next(iter(session.document.trials))
    ask = Ask.of_trial(session.document.trials[shown], session.document.choice.model)
    motion = StudioSolver(Bending).answer(ask).points
    assert motion is not None
    pairs = zip(motion, ask.measured, strict=True)
    expected = np.mean([capped_rms(Surface.of_faces(points).distance(cloud)) for points, cloud in pairs])
    assert session.playing.errors[shown][0].surface_rms == pytest.approx(expected)
    lines = errors_table(session.playing.errors).splitlines()
    assert lines[-1].startswith(f"| **mean of {len(session.document.trials)}** |")
    assert f"| {shown} | {1e3 * expected:.2f} |" in lines[4]
    session.document.choose(session.document.choice.switched("frame_tilt", True))
    assert session.playing.errors == {}  # they were of another model
    session.end()


# the corrector


class Lifting:
    """A corrector that moves every point by 2 mm towards the viewer, where the layout has fewer than nine muscles."""

    ordered, starts = True, 0.0

    def history(self) -> tuple[float, ...]:
        return (0.1,)

    def trust(self, design: Design) -> Trust:
        return Trust(0.1 * len(design.muscles), 0.85)

    def correct(self, cases: list[Case], times: list[np.ndarray], motions: list[np.ndarray]) -> list[np.ndarray]:
        moved = []
        for case, at, motion in zip(cases, times, motions, strict=True):
            _, where = with_history(at, self.history())
            by = 2e-3 if self.trust(case.design).applies else 0.0
            moved.append(motion[where[0]] + np.float32([0, 0, by]))
        return moved


@pytest.fixture
def lifted(monkeypatch: pytest.MonkeyPatch) -> StudioSolver:
    solver = StudioSolver(Bending)
    monkeypatch.setattr(
        solver,
        "_predictor",
        lambda simulator, model: Predictor(simulator, model, corrector=None if model.corrector is None else Lifting()),
    )
    return solver


LIFTED = Model(corrector=Path("weights"), corrector_hash="0")


def test_a_corrected_shape_has_the_simulated_one_beside(lifted: StudioSolver) -> None:
    answer = lifted.answer(Ask.at_rest("exact", BASIC.design, BASIC.pressures, LIFTED))
    assert answer.points is not None
    assert answer.correction is not None
    assert answer.correction.trust == Trust(pytest.approx(0.8), 0.85)
    assert answer.correction.moved(answer.points) == pytest.approx(2e-3, abs=1e-7)
    plain = lifted.answer(Ask.at_rest("exact", BASIC.design, BASIC.pressures, LIFTED.without(["corrector"])))
    assert plain.correction is None
    assert np.array_equal(answer.correction.simulated, plain.points)
    far = edits.add_muscle(BASIC)
    beyond = lifted.answer(Ask.at_rest("exact", far.design, far.pressures, LIFTED))
    assert beyond.correction is not None
    assert not beyond.correction.trust.applies
    assert not beyond.correction.moved(beyond.points).any()
    followed = lifted.answer(Ask.at_rest("follow", BASIC.design, BASIC.pressures, LIFTED))
    assert followed.correction is not None  # how far it is, while it is dragged
    assert np.array_equal(followed.points, followed.correction.simulated)


def test_a_corrected_motion_is_simulated_once(lifted: StudioSolver, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[np.ndarray] = []
    motions = Bending.motions
    monkeypatch.setattr(Bending, "motions", lambda self, c, times: asked.extend(times) or motions(self, c, times))
    times = np.array([0.0, 0.2, 0.25])
    cloud = bow(Case(BASIC.design, constant_program([0.0] * 8))).reshape(-1, 3).astype(float) + [0, 0, 3e-3]
    ask = Ask("motion", Case(BASIC.design, constant_program([0.0] * 8)), LIFTED, times, measured=(cloud,) * 3)
    answer = lifted.answer(ask)
    (once,) = asked
    assert once == pytest.approx([0.0, 0.1, 0.15, 0.2, 0.25])  # with the instants that the corrector looks back to
    assert answer.points is not None
    assert answer.points.shape == (3, 3362, 3)
    assert [1e3 * errors.surface_rms for errors in answer.errors] == pytest.approx([2.0, 0.0], abs=1e-3)


def test_the_corrector_is_on_a_switch() -> None:
    choice = ModelChoice.of(LIFTED)
    assert choice.model is LIFTED
    assert replace(choice, corrected=False).model.corrector is None
    assert choice.switched("frame_tilt", True).model.corrector is None  # it was trained beside other effects


# intervals


def test_the_band_is_the_covariance_at_the_edge() -> None:
    names = ("membrane", "bending", "muscle_gain")
    root = np.array([[0.1, 0, 0], [0.05, 0.08, 0], [-0.02, 0.03, 0.06]])
    model = Model({name: Parameter(1.0) for name in names}, covariance=Covariance(names, root @ root.T))
    slopes = np.random.default_rng(2).normal(size=(3, 41, 3))  # m of the edge for each logarithm

    def shape(one: Model) -> np.ndarray:
        points = np.zeros((2, 41, 41, 3))
        points[:, -1] = np.tensordot([np.log(one.parameters[name].factor) for name in names], slopes, 1)
        return points.reshape(-1, 3)

    band = half_band([shape(one) for one in ModelChoice.of(model).around])
    expected = NORMAL90 * np.sqrt(np.einsum("ikd,ij,jkd->kd", slopes, root @ root.T, slopes))
    assert band == pytest.approx(expected, rel=1e-5)
    assert not ModelChoice.of(Model()).around


def test_a_band_comes_with_the_exact_shape_and_goes_with_an_edit(begin: Begin) -> None:
    model = Model({"bending": Parameter(1.0)}, covariance=Covariance(("bending",), np.array([[0.01]])))
    session, _, worker, clock = begin(model=model)
    settle(session, clock)
    assert session.shapes.band is not None
    assert [ask.kind for ask in worker.asked] == ["follow", "exact", "nearby", "nearby"]
    session.document.press(0, 100e3)
    assert session.shapes.band is None
    settle(session, clock)
    assert session.shapes.band is not None


# target and search


def target_at(layout: Layout, path: Path, *, every: int = 1) -> LoadedTarget:
    """The cloth's own shape as a target, every so many points of a row."""
    ask = Ask.at_rest("exact", layout.design, layout.pressures, Model())
    np.savetxt(path, bow(ask.case)[::every, ::every].reshape(-1, 3))
    return load_target(TargetFile(path), layout.design)


def test_the_distance_to_a_target_is_that_of_the_metrics(tmp_path: Path) -> None:
    target = target_at(BASIC, tmp_path / "flat.xyz")
    flat = np.concatenate([target.points + [0, 0, z] for z in (1e-3, -1e-3)]).astype(np.float32)
    comparison = Comparison.of(target, flat, BASIC.design)
    assert comparison.errors.surface_rms == pytest.approx(1e-3, rel=1e-4)
    assert Surface.of_faces(flat).distance(target.points) == pytest.approx(np.full(41 * 41, 1e-3), rel=1e-4)
    assert comparison.of_cloth == pytest.approx(np.full(2 * 41 * 41, 1e-3), rel=1e-4)
    assert "surface RMS 1.00 mm (noise floor" in comparison.sentences[1]


def test_the_study_of_a_search_reads_back(tmp_path: Path) -> None:
    shown = target_at(BASIC, tmp_path / "flat.xyz")
    target = replace(shown, file=replace(shown.file, face="front", distances="one way"))
    folder = tmp_path / "search"
    folder.mkdir()
    write_design(BASIC.design, folder / "design.toml")
    layout = BASIC.with_pressure(0, 125.5e3)
    for vary, positions, counts in (
        ("pressures", False, None),
        ("pressures and positions", True, None),
        ("one more muscle", True, range(9, 10)),
    ):
        limits = Limits(contraction=0.3, evaluations=50)
        text = study_document(layout, [target], limits, vary=vary, seconds=7, model=None, beside=folder)
        (folder / "study.toml").write_text(text)
        study = read_study(folder / "study.toml")
        assert study.positions is positions
        assert (None if study.muscles is None else study.muscles.counts) == counts
        assert study.limits == replace(limits, seconds=7)
        assert study.start_pressures is not None
        assert study.start_pressures[0] == 125.5e3
        assert study.targets[0].file.resolve() == (tmp_path / "flat.xyz").resolve()
        assert (study.targets[0].face, study.targets[0].distances) == ("front", "one way")


@pytest.mark.parametrize("kept", [True, False])
def test_a_search_that_is_stopped_after_its_end_keeps_its_result(
    kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C while the program writes its report, or ends: it says nothing of a result, which lies there."""
    write = "p.parent.mkdir(); p.write_text('{}')" if kept else "pass"
    program = f"""
import pathlib, signal, sys, time
p = pathlib.Path(sys.argv[4]) / "result.json"
{write}
print("best 3.9 mm", file=sys.stderr, flush=True)
signal.signal(signal.SIGINT, signal.SIG_DFL)
(p.parents[1] / "ready").touch()
time.sleep(60)
"""
    monkeypatch.setattr("studies.studio.search.PROGRAM", (sys.executable, "-c", program))
    target = target_at(BASIC, tmp_path / "flat.xyz")
    search = Search(tmp_path / "s", BASIC, [target], Limits(), vary="pressures", seconds=60)
    while not (tmp_path / "s" / "ready").exists():
        assert search.running
        time.sleep(0.05)
    search.stop()
    while search.running:
        time.sleep(0.05)
    assert search.problem == (None if kept else "best 3.9 mm")
    search.close()


class Searching(Result):
    """In the place of a search: the best so far is what a test says."""

    better: Layout | None = None
    running, problem = True, None

    def __init__(self, folder: Path, layout: Layout, targets: list[LoadedTarget], limits: Limits, **_: object) -> None:
        super().__init__()
        self.folder = folder

    def read(self) -> bool:
        better, Searching.better = Searching.better, None
        if better is not None:
            self.hold((better,), 3e-3)
        return better is not None

    def close(self) -> None: ...


def test_a_result_is_a_drawing_of_its_own(begin: Begin, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.studio.search.Search", Searching)
    monkeypatch.setattr(Searching, "running", True)
    target = target_at(BASIC.with_pressure(0, 200e3), tmp_path / "bowed.xyz", every=4)
    session, _, _, clock = begin(targets=(target,))
    session.document.edit("flip", lambda layout: edits.flip(layout, 7))
    settle(session, clock)
    drawing = session.document.layout
    session.search.start("one more muscle", 10)
    better = edits.move_muscle(edits.add_muscle(drawing.with_pressure(0, 190e3)), 8, (-0.022, 0.0))
    Searching.better = better
    settle(session, clock, 4.0)
    assert session.document.layout == better  # it moves in
    assert session.document.history.layout == drawing
    result = session.document.results[0]
    (mine, _), (chamfer, _) = (session.document.errors_of(one) for one in (session.document.history, result))
    assert chamfer == result.comparison.errors.chamfer < mine
    table = results_table(session.document)
    assert f"<td>own drawing</td><td>8</td><td>{1e3 * mine:.2f}</td>" in table
    assert re.search(rf"<td>9</td><td>{1e3 * chamfer:.2f}</td><td>[\d.]+</td><td>190</td>", table)
    line = session.document.one_more_buys(result)
    assert f"{1e3 * mine - 3:.2f} mm less than {1e3 * mine:.2f} mm with 8 (own drawing)" in str(line)
    rival = Result(name="search 2", begun=drawing, layouts=(drawing,), objective=3.2e-3)
    session.document.results.append(rival)
    assert "0.20 mm less than 3.20 mm with 8 (search 2)" in str(session.document.one_more_buys(result))
    assert session.document.one_more_buys(rival) is None
    session.document.results.pop()
    monkeypatch.setattr(Searching, "running", False)
    settle(session, clock, 4.0)
    assert not session.search.running
    session.document.show_result(None)
    settle(session, clock)
    assert session.document.layout == drawing
    assert session.document.other.at(0) == better
    session.document.show_result(session.document.results[0])
    session.document.press(1, 50e3)  # an edit takes it
    settle(session, clock)
    assert session.document.shown is None
    assert session.document.layout == better.with_pressure(1, 50e3)
    session.document.step(-1)
    session.document.step(-1)
    assert session.document.layout == drawing


def test_poses_have_their_own_target_and_pressures(begin: Begin, tmp_path: Path) -> None:
    targets = tuple(target_at(BASIC.with_pressure(k, 2e5), tmp_path / f"{k}.xyz", every=4) for k in (0, 4))
    session, _, _, clock = begin(targets=targets)
    session.document.press(0, 200e3)
    settle(session, clock)
    first = session.document.seen.comparison
    session.document.show_pose(1)
    session.document.press(0, 0.0)
    session.document.press(4, 200e3)
    settle(session, clock)
    assert session.document.target is targets[1]
    assert session.document.seen.comparison.errors.surface_rms == pytest.approx(first.errors.surface_rms, rel=0.5)
    session.document.show_pose(0)
    settle(session, clock)
    assert session.document.layout.pressures[:5] == (200e3, 0, 0, 0, 0)
    session.document.show_pose(1)
    session.document.step(-1)
    settle(session, clock)
    assert session.document.pose == 0
    assert session.document.seen.comparison.errors.surface_rms == first.errors.surface_rms  # beside its own target
    session.document.step(1)
    assert (session.document.pose, session.document.layout.pressures[4]) == (1, 200e3)
    assert not session.document.history.layout.same_content(BASIC)
    assert session.document.history.layout.same_content(session.document.history.at(0))  # no pose shown is unsaved
    session.files.save(tmp_path / "mine")
    study = read_study(tmp_path / "mine" / "study.toml")
    assert [target.file.name for target in study.targets] == ["0.xyz", "4.xyz"]
    for pose, (file, channel) in enumerate((("pressures.csv", 0), ("pressures_2.csv", 4))):
        program = read_pressures(tmp_path / "mine" / file, session.document.layout.design)
        assert program.pressure[-1].tolist() == [200e3 * (k == channel) for k in range(8)], pose
    assert len(open_files([tmp_path / "mine" / "study.toml"], None).targets) == 2
    session.document.open_target(None)  # this pose is no more
    assert (session.document.targets, session.document.pose) == ([targets[0]], 0)
    assert [layout.pressures for layout in session.document.layouts] == [(200e3, *(0.0,) * 7)]


def test_a_trials_frame_is_compared_with_the_motion_there(begin: Begin, folder: Path) -> None:
    trial = next((folder / "set" / "trials").glob("*.npz"))
    target = load_target(TargetFile(trial, frame=1), build("basic"))
    session, shown, worker, clock = begin(targets=(target,))
    settle(session, clock)
    exact = next(ask for ask in worker.asked if ask.kind == "exact")
    assert exact.times == [target.time]
    assert shown.shapes[-1].time == target.time
    assert session.document.seen.comparison is not None


# the model


def test_effects_are_switched_with_amounts_that_show() -> None:
    given = Model(
        {"bending": Parameter(1.2)},
        effects=(EffectTerm("filling_lag", {"time_constant": Quantity(0.2, "s")}, scope="rig"),),
    )
    choice = ModelChoice.of(given)
    assert choice.model is given
    off = choice.switched("filling_lag", False)
    assert (off.model.effects, off.model.factors) == ((), {"bending": 1.2})
    assert off.switched("filling_lag", True).model is given
    tilted = off.switched("frame_tilt", True)
    assert any(value != 0 for value in tilted.effect_values["frame_tilt"].values())
    sheet = choice.sheet(False)
    assert (sheet.model.factors, sheet.model.effects) == ({}, ())


def test_fields_of_effects_hold_their_values_within_the_declared_limits(begin: Begin) -> None:
    session, *_ = begin()
    choice = session.document.choice
    for name, effect in EFFECTS.items():
        choice = choice.switched(name, effect.site != "sensing")
    session.document.choose(choice)
    folders = {part.name.replace(" ", "_"): part.inside for part in model(session.document)}
    assert [*folders] == [*choice.effect_values]
    for name, (switch, *fields) in folders.items():
        assert switch.value
        for field, key in zip(fields, sorted(choice.effect_values[name]), strict=True):
            declared = EFFECTS[name].parameters[key]
            assert (field.given["min"], field.given["max"]) == declared.bounds
            assert field.given["min"] <= field.value <= field.given["max"]  # viser refuses others
            assert (field.value, field.given["hint"]) == (round(choice.effect_values[name][key], 6), declared.what)


# scene


def test_what_is_pointed_at_is_the_point_of_the_cloth() -> None:
    places = Places.of(BASIC.design.fabric)
    eye = np.array([0.4, 0.3, 1.2])
    for side in ("front", "back"):
        for point in ((0.03, 0.15), (0.2, 0.0)):
            at = places.flat(np.array([point]), side)[0]
            through = on_plane(eye, eye + 0.37 * (at - eye), at[2])
            assert through is not None
            assert places.fabric_point(through, side) == pytest.approx(point)
    assert on_plane(eye, eye + [0.0, 0.0, 1.0], 0.0) is None


def test_muscles_lie_off_their_own_face() -> None:
    points = np.concatenate([np.reshape(bow_flat(z), (-1, 3)) for z in (1e-3, -1e-3)]).astype(np.float32)
    for index, sign in ((0, 1), (4, -1)):
        muscle = BASIC.design.muscles[index]
        line = laced(points, muscle, BASIC.design.fabric)
        expected = muscle.fixed_points()
        assert line[:, 0] == pytest.approx(expected[:, 0] - 0.1, abs=1e-6)
        assert line[:, 1] == pytest.approx(-expected[:, 1], abs=1e-6)
        assert (sign * line[:, 2] > 1e-3).all()
    vertices, triangles = ribbon(np.array([[0.0, 0, 0], [0.1, 0, 0]]), 0.01)
    area = np.linalg.norm(np.cross(*(vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2))), axis=1)
    assert area.sum() / 2 == pytest.approx(0.01 * 0.11)


def bow_flat(z: float) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(-0.1, 0.1, 41), np.linspace(0, -0.2, 41))
    return np.stack([u, v, np.full_like(u, z)], axis=-1)


# the command


def test_what_it_is_opened_on(run: Run, folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("viser")
    one_line(run("studio", folder / "none.toml"), "none.toml")
    one_line(run("studio", folder / "model.toml"), "expected a design, a study or a measurement set")
    one_line(run("studio", folder / "cross.toml", folder / "bare.toml"), "expected one")
    one_line(run("studio", folder / "cross.toml", folder / "x.docx"), "expected a design, study, set, target")
    opened = open_files([folder / "cross.toml", folder / "p.csv"], folder / "model.toml")
    assert opened.layout.pressures == (200e3, 50e3)
    assert opened.model is not None
    assert open_files([], None).layout.design.muscles == build("basic").muscles


def test_without_the_extra_one_line_says_how(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    code, out, err = run("studio", "--no-browser")
    assert (code, out) == (1, "")
    assert err == "fabdesign: needs viser; install it with: pip install 'fabdesign[studio]'\n"


def test_help_loads_nothing_heavy() -> None:
    script = (
        "import sys; sys.argv = ['fabdesign', 'studio', '--help']\nfrom fabdesign.cli import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "print([m for m in ('viser', 'taichi', 'scipy', 'asyncio') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "--no-browser" in done.stdout
    assert done.stdout.endswith("[]\n")


# the page, without a browser to see it


@pytest.mark.parametrize("size", [(0.2, 0.2), (0.5, 0.2), (0.2, 0.5)])
@pytest.mark.parametrize("window", [(800, 750), (800, 1000), (1200, 900), (1500, 600)])  # px, what the panel leaves
def test_all_is_in_the_first_view_and_bending_shows(size: tuple[float, float], window: tuple[int, int]) -> None:
    from studies.studio.widgets.flat_view import HUNG_TURN, VIEW, eye_of

    places = Places(*size)
    width, height = window
    eye = np.array(eye_of(places, width / height))
    forward = -eye / np.linalg.norm(eye)
    right = np.cross(forward, [0, 1, 0]) / np.linalg.norm(np.cross(forward, [0, 1, 0]))

    def on_screen(points: np.ndarray) -> np.ndarray:
        to = points - eye
        across, up = to @ right, to @ np.cross(right, forward)
        return np.stack([across, up], axis=-1) / (to @ forward)[:, None] * height / 2 / np.tan(VIEW / 2)

    u, v = (line.ravel() for line in np.meshgrid([0.0, 0.5, 1.0], [0.0, 0.5, 1.0]))
    flat = [places.flat(np.stack([u, v], axis=1) * size, side) for side in ("front", "back")]
    hung = np.stack([(1.08 * u - 0.54) * size[0], -v * size[1], 0 * u], axis=1)
    depth = 0.2 * size[1] * v**2
    forth, back = (HUNG_TURN.apply(hung + sign * depth[:, None] * [0, 0, 1]) + places.hung_origin for sign in (1, -1))
    seen = on_screen(np.concatenate([*flat, forth, back]))
    assert (np.abs(seen) < np.array(window) / 2).all()
    ahead, behind = on_screen(forth), on_screen(back)
    assert np.linalg.norm(ahead[6] - behind[6]) > 0.2 * np.linalg.norm(behind[6] - behind[0])  # of the left edge


def test_the_page_draws_all_that_a_session_holds(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("viser")
    from studies.studio.server import Gate, quiet_viser
    from studies.studio.widgets.page import Page

    monkeypatch.chdir(folder)
    write_design(BASIC.design, folder / "basic.toml")
    target = target_at(BASIC.with_pressure(0, 200e3), folder / "bowed.asc", every=4)
    with contextlib.closing(Gate("127.0.0.1", None)) as gate, quiet_viser(gate) as server:
        page = Page(server, open_files([Path("basic.toml"), target.file.file], folder / "model.toml"), AtOnce())
        session = page.session
        turns = iter(range(20))
        points, export = "Ends and corners, mm from the upper left", ("Sewing template, 1:1", "Export template")
        into = "Sewing template, 1:1", "Folder"
        page.run(lambda: next(turns) == 12)

        def run() -> None:
            for _ in range(20):
                page.turn()
                session.playing.advance(0.02)

        assert session.shapes.shown is not None
        assert session.shapes.shown.exact
        assert server.scene.get_handle_by_name("/hung/distances") is not None
        faces = [server.scene.get_handle_by_name(f"/hung/{side}") for side in ("front", "back")]
        assert all(face.visible for face in faces)  # a surface is there whether or not a browser has the colours
        session.document.edit("add", lambda layout: edits.add_corner(edits.add_muscle(layout, 0), 8))
        session.document.edit("move", lambda layout: edits.move_muscle(layout, 8, (-0.022, 0.0)))
        session.document.choose(session.document.choice.switched("frame_tilt", True))
        widget(page, "Target", "Placed by hand", "Gizmo").part.then(True)
        page.turn()
        assert server.scene.get_handle_by_name("/hung/gizmo") is not None
        session.document.place_target((0.0, 0.0, 5.0), (0.0, 0.001, 0.0))
        run()
        assert session.document.target is not None
        assert session.document.target.file.rotation == (0.0, 0.0, 5.0)
        assert server.scene.get_handle_by_name("/flat/corner_8_2") is not None
        session.document.select(8)
        page.turn()
        assert [made.part.name for made in widget(page, "Layout", points).inside] == ["End 0", "Corner 1", "End 2"]
        session.document.select(1)
        page.turn()
        assert [made.part.name for made in widget(page, "Layout", points).inside] == ["End 0", "End 1"]
        assert "muscles 1 and 8" in widget(page, "limits").handle.content
        session.playing.rise()
        run()
        assert session.playing.motion is not None
        assert session.playing.frame > 0
        session.document.edit("remove", lambda layout: edits.remove_muscle(layout, 8))
        page.turn()
        assert server.scene.get_handle_by_name("/flat/corner_8_2") is None
        run()
        result = Result(
            name="search 1", begun=session.document.layout, layouts=(session.document.layout.with_pressure(1, 9e4),)
        )
        session.document.results.append(result)
        session.document.show_result(result)
        run()
        assert server.scene.get_handle_by_name("/hung/other") is not None  # the own drawing beside it
        assert server.scene.get_handle_by_name("/flat/other") is not None
        assert "<td>search 1</td><td>8</td>" in widget(page, "Results", "table").handle.content
        session.document.set_option("beside", False)
        page.turn()
        assert server.scene.get_handle_by_name("/hung/other") is None
        assert "<polyline" in widget(page, "Model", "profile").handle.content
        widget(page, "Files", *export).part.then(widget(page, "Files", *into).value, True)
        template = folder / "basic_template"
        cut_list = (template / "design_cut_list.csv").read_text()
        export_design(session.document.layout.design, folder / "exported", Sewing(tail_length=0.03), stem="design")
        assert cut_list == (folder / "exported" / "design_cut_list.csv").read_text()
        assert (template / "design_a4.pdf").is_file()
        page.turn()
        assert "sewing template in basic_template: " in widget(page, "message").handle.content
        (template / "design_a4.pdf").unlink()
        widget(page, "Files", *export).part.then(widget(page, "Files", *into).value, True)  # asks first
        assert not (template / "design_a4.pdf").exists()
        session.end()
