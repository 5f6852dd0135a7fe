"""The loop: a design chosen, measured, learned from, chosen again."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from sheets import rolled_sheet

from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.measurement_set import NewTrial, TrialData, read_set, write_set
from fabdesign.files.model_file import read_model
from fabdesign.files.pressure_file import constant_program, read_pressures
from fabdesign.geometry.sensor_noise import SensorNoise
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.catalogue import build, standard
from fabdesign.nouns.forward import Case
from fabdesign.nouns.model import Model
from fabdesign.nouns.pressure import LEAST_HOLD, PressureProgram, rising_program
from fabdesign.nouns.trial import MeasurementSet
from fabdesign.output import work_folder
from fabdesign.runtime.fingerprint import OtherContent
from fabdesign.study_files.loop_file import LoopStudy, StopRule
from studies.check.design import study_findings
from studies.loop.learning import Lesson
from studies.loop.measuring import Asked, programs_for, within_rate
from studies.loop.record import stop_reason
from studies.loop.resting_shape import resting_faces
from studies.loop.run import run_loop
from studies.measured.fit_data import TooLittle
from tests.analytic_cloth import AnalyticCloth
from tests.command_line import Run, one_line
from tests.restricted_effects import restrict_effects

NOISE = SensorNoise(0.0006, 0.002, 0.02)
GAIN = 0.7  # of the devices' muscles
HIDDEN = 1e3 * np.array([240.0, 120.0])  # Pa
STUDY = """format = "fabdesign.study/1"
kind = "loop"
design = "start.toml"
points_per_side = 15
[target]
file = "target.xyz"
[limits]
pressure = [0.0, 400.0]
evaluations = 80
[rig]
key = "key.toml"
[trials]
number = 3
[learning]
trace = false
[stop]
turns = 1
"""
LABORATORY = STUDY.replace(
    '[rig]\nkey = "key.toml"', '[laboratory]\nfolder = "lab"\ntail_length = 0.03\npaper = "none"'
)


CURL = 1.5  # 1/m, of a cloth that no declared parameter bends at rest
TRAINED = STUDY.replace("trace = false\n", 'trace = false\ntrain = "field"\ntrain_trials = 3\n')
TRAINED = TRAINED.replace("number = 3", "number = 6")


class Weak(AnalyticCloth):
    """Muscles pull by their gain."""

    def _shape(self, case: Case, share: float) -> NDArray[np.float32]:
        gain = case.factors.get("muscle_gain", case.factors.get("muscle_types.EM20.muscle_gain", 1.0))
        program = replace(case.program, pressure=case.program.pressure * gain)
        return super()._shape(replace(case, program=program), share)


def on_device(asked: Asked, out: Path, *, curl: float = 0.0) -> MeasurementSet:
    """What a device with weak muscles shows. curl: 1/m, of its cloth, down its length, at any pressure."""
    trials, rng = [], np.random.default_rng(7)
    for order, program in enumerate(asked.programs):
        times = np.arange(1, round(10 * program.duration) + 1) / 10
        case = Case(asked.design, program, {"muscle_gain": GAIN})
        shapes = curled(Weak().motions([case], [times])[0], curl)
        clouds = tuple(NOISE.draw(Surface.of_faces(shape), 300, rng) for shape in shapes)
        trials.append(NewTrial(f"t{order}", "d", order, "fit", TrialData(times, program.at(times - 1e-6), clouds)))
    write_set(out, {"d": asked.design}, trials, name="device", description="synthetic")
    return read_set(out)


def curled(shapes: NDArray[np.float32], curl: float) -> NDArray[np.float32]:
    """(..., points, 3) m, to first order."""
    forwards = 0.5 * curl * shapes[..., 1:2] ** 2
    return shapes + np.concatenate([np.zeros_like(shapes[..., :2]), forwards], axis=-1)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study whose target is what a device with weak muscles can take."""
    design = build("cross")
    write_design(design, tmp_path / "start.toml")
    shape = Weak().equilibria([Case(design, constant_program(HIDDEN), {"muscle_gain": GAIN})])[0]
    np.savetxt(tmp_path / "target.xyz", NOISE.draw(Surface.of_faces(shape), 1500, np.random.default_rng(3)))
    (tmp_path / "key.toml").write_text('format = "fabdesign.key/1"\n')
    restrict_effects(monkeypatch, "filling_lag", "orthotropy", "frame_tilt")
    (tmp_path / "study.toml").write_text(STUDY)
    (tmp_path / "lab.toml").write_text(LABORATORY)
    monkeypatch.setattr(
        "studies.loop.measuring.measured_on_rig",
        lambda source, asked, out, progress: on_device(asked, out),
        raising=True,
    )
    return tmp_path


def simulators(points_per_side: int) -> AnalyticCloth:
    return Weak()  # its shapes change with its points


class Killed(BaseException):
    pass


def test_a_turn_brings_the_device_nearer_also_when_it_is_killed_on_the_way(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured: list[int] = []

    def device(source: object, asked: Asked, out: Path, progress: Callable[[int, int], None]) -> MeasurementSet:
        measurement_set = on_device(asked, out)
        measured.append(len(asked.programs))
        progress(1, len(asked.programs))
        return measurement_set

    monkeypatch.setattr("studies.loop.measuring.measured_on_rig", device)
    for at in ("turn 0, measuring: ", "turn 1, evaluating the shape"):

        def killing(line: str, share: float | None, at: str = at) -> None:
            if line.startswith(at):
                raise Killed

        with pytest.raises(Killed):
            run_loop(place / "study.toml", place / "out", simulators=simulators, progress=killing)
    outcome = run_loop(place / "study.toml", place / "out", simulators=simulators)
    assert measured == [4, 4, 1]  # only what was under way again; in the last turn the shape alone
    first, second = (turn.device["excess"] for turn in outcome.turns if turn.device)
    assert first > 2 > 4 * second
    assert outcome.turns[0].chosen["believed"]["excess"] < 0.5  # the data sheet does not know
    learned = outcome.turns[0].learned
    assert learned is not None
    assert learned["factors"]["muscle_types.EM20.muscle_gain"] == pytest.approx(GAIN, rel=0.05)
    assert learned["held_out"]["after"] < 0.5 * learned["held_out"]["before"]
    result = json.loads((place / "out" / "result.json").read_text())
    assert result["best"] == "turn_1" and result["stop_reason"] == outcome.stop_reason
    design = read_design(place / "out" / "design.toml")
    pressures = read_pressures(place / "out" / "pressures.csv", design).pressure[-1]
    assert pressures == pytest.approx(HIDDEN, rel=0.1)
    page = (place / "out" / "report.html").read_text()
    assert "synthetic rig" in page and page.count("<h2>Turn") == 2
    again = run_loop(place / "study.toml", place / "out", simulators=simulators)
    assert again.turns == outcome.turns and len(measured) == 3
    (place / "key.toml").write_text('format = "fabdesign.key/1"\nseed = 2\n')
    with pytest.raises(InputError, match="holds other work"):
        run_loop(place / "study.toml", place / "out", simulators=simulators)


def test_a_network_learns_what_remains_and_the_next_design_is_chosen_with_it(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shape = Weak().equilibria([Case(build("cross"), constant_program(HIDDEN), {"muscle_gain": GAIN})])[0]
    surface = Surface.of_faces(curled(shape, CURL))
    np.savetxt(place / "target.xyz", NOISE.draw(surface, 1500, np.random.default_rng(3)))
    monkeypatch.setattr(
        "studies.loop.measuring.measured_on_rig", lambda source, asked, out, _: on_device(asked, out, curl=CURL)
    )
    (place / "study.toml").write_text(TRAINED)
    outcome = run_loop(place / "study.toml", place / "out", simulators=simulators)
    learned = outcome.turns[0].learned
    assert learned is not None and learned["corrector"]
    model = read_model(place / "out" / "turn_0" / "model.toml")
    assert model.corrector is not None and model.corrector.is_file()
    assert learned["held_out"]["after"] < 0.5 * learned["held_out"]["before"]
    first, second = (turn.device for turn in outcome.turns if turn.device)
    assert second["from_believed"] < 0.5 * first["from_believed"]
    assert second["excess"] < 0.7 * first["excess"]
    assert "network field learned from" in (place / "out" / "report.html").read_text()


def test_a_network_that_is_of_no_use_on_trials_kept_back_is_not_used(place: Path) -> None:
    (place / "study.toml").write_text(TRAINED)
    design = build("cross")
    programs = tuple(rising_program(np.array(p) * 1e3, 0.5, 1.0) for p in ((100, 300), (300, 100), (250, 250)))
    measured = on_device(Asked(design, programs, 1), place / "set")  # gain alone, which calibration finds
    with work_folder(place / "work", made_by="loop") as work:
        lesson = Lesson(LoopStudy.read(place / "study.toml"), [measured], work, "turn_0", simulators, say=print)
        learned = lesson.learn(Model())
        assert not learned["corrector"] and learned["said"][-1].endswith("it is not used")
        assert read_model(place / "work" / "turn_0" / "model.toml").corrector is None
        assert not list((place / "work" / "turn_0").glob("*.safetensors"))


def test_a_trace_that_other_code_began_is_begun_anew(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    forced: list[bool] = []

    def traced(*_: object, force: bool = False, **__: object) -> None:
        forced.append(force)
        raise TooLittle("d: 2 trials") if force else OtherContent("out: holds another trace")

    monkeypatch.setattr("studies.tracing.trace_set", traced)
    design = build("cross")
    measured = on_device(Asked(design, (constant_program(HIDDEN),), 1), place / "set")
    with work_folder(place / "work", made_by="loop") as work:
        lesson = Lesson(LoopStudy.read(place / "study.toml"), [measured], work, "turn_0", simulators, say=print)
        trace = lesson.traced(measured, Model())
    assert forced == [False, True]
    assert trace == (None, None, ["not traced: d: 2 trials"])


def test_a_laboratory_is_asked_and_answers(place: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sim.Simulator", lambda *_, **__: Weak(), raising=False)
    command = ("loop", place / "lab.toml", "-o", place / "out")
    answer = place / "lab" / "turn_0"
    assert study_findings(place / "lab.toml").problems == ()
    code, out, err = run(*command, "--json")
    assert code == 0, err
    assert json.loads(out)["waiting_for"] == str(answer) and not json.loads(out)["stop_reason"]
    asked = place / "out" / "turn_0" / "to_measure"
    assert {"design.toml", "README.txt", "000.csv", "003.csv"} <= {file.name for file in asked.iterdir()}
    assert (asked / "sew" / "design_cut_list.csv").is_file() and (asked / "sew" / "design_front.svg").is_file()
    assert "order 3: 003.csv, 1.5 s, role test" in (asked / "README.txt").read_text()
    design = read_design(asked / "design.toml")
    programs = tuple(read_pressures(asked / f"00{k}.csv", design) for k in range(4))
    for bad, problem in (
        (programs[:3], "no trial of order 3"),
        ((*programs[:3], constant_program([1e5, 3e5])), "order 3 ran other pressures than 003.csv"),
    ):
        on_device(Asked(design, bad, 1), answer)
        code, out, err = run(*command)
        assert code == 2 and problem in err.splitlines()[-1]
        answer.rename(place / problem)
    on_device(Asked(design, programs, 1), answer)
    code, out, err = run("study", *command[1:])  # the same command
    assert code == 0, err
    assert "turn 0: predicted" in out and f"waiting for a measurement set in {place / 'lab' / 'turn_1'}" in out
    assert read_set(place / "out" / "turn_0" / "measured").trials[-1].role == "test"


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ('[rig]\nkey = "key.toml"', "", "expected one source of measurements, [rig] or [laboratory]"),
        ('"key.toml"', '"nokey.toml"', "nokey.toml is not there"),
        ("[rig]", "[laboratory]\nfolder = 'x'\n[rig]", "expected one source of measurements"),
        ('[rig]\nkey = "key.toml"', '[laboratory]\nfolder = "lab"', "has no tail_length"),
        ("[rig]", "[rig_limits]\nchannels = 1\n[rig]", "up to 2 muscles; the rig has 1 channels"),
        ("[rig]", "[rig_limits]\nduration = 1\n[rig]", "duration = 1; a rise of 1 s"),
        ("number = 3", "number = 2", "expected 2 more than are held out"),
        ("turns = 1", "turn = 1", "did you mean turns?"),
        ("trace = false", 'train = "fields"', "did you mean field?"),
        ("[limits]", "[variables]\npressures = false\n[limits]", "nothing may change"),
        ('file = "target.xyz"', 'file = "start.toml"', "start.toml"),
    ],
)
def test_bad_studies_are_refused_in_a_line(place: Path, run: Run, old: str, new: str, problem: str) -> None:
    (place / "study.toml").write_text(STUDY.replace(old, new))
    one_line(run("loop", place / "study.toml", "-o", place / "out"), problem)
    assert not (place / "out").exists()
    assert run("check", place / "study.toml")[0] == 2


def test_a_rig_sets_the_pressures_and_the_rise(place: Path) -> None:
    limits = "[rig_limits]\npressure = 250\nrate = 100\n"
    (place / "study.toml").write_text(STUDY.replace("[rig]", f"{limits}[rig]"))
    study = LoopStudy.read(place / "study.toml")
    assert study.search.limits.pressure == (0.0, 250e3)
    assert study.search.rise == pytest.approx(2.5)
    asked = programs_for(study, build("cross"), np.array([[250e3, 50e3]]), [None], seed=0)
    assert [asked.role(k) for k in range(len(asked.programs))] == ["fit", "fit", "fit", "test"]
    for program in asked.programs:
        assert program.pressure.max() <= 250e3
        edges = np.append(program.time, program.duration)
        steps = np.abs(np.diff(np.vstack([np.zeros(2), program.pressure]), axis=0)).max(axis=1)
        assert (steps <= 100e3 * np.maximum(np.diff(edges), 0.05) + 150).all()
    assert asked.programs[0].pressure[-1] == pytest.approx([250e3, 50e3])
    free = replace(
        study, rig_limits=replace(study.rig_limits, rate=np.inf), trials=replace(study.trials, seconds=1.5, number=6)
    )
    _, *others = programs_for(free, build("cross"), np.array([[123456.7, 50e3]]), [None], seed=0).programs
    for program in others:  # levels hold until the cloth stands, and are settings of a regulator
        assert np.diff([*program.time, program.duration]).min() >= LEAST_HOLD
        assert program.pressure.tolist() == (100 * np.round(program.pressure / 100)).tolist()
    up, down = others[1].pressure
    assert (up >= down).all() and up.max() > down.max() > 0  # friction shows where a level is come to from above


def test_a_program_within_a_rate_reaches_what_it_can() -> None:
    step = PressureProgram(np.array([0.0, 0.5]), np.array([[100e3], [0.0]]), 1.0)
    assert within_rate(step, np.inf) is step
    slow = within_rate(step, 400e3)
    assert slow.at(np.array([0.0, 0.24, 0.5, 0.76]))[:, 0] == pytest.approx([20e3, 100e3, 80e3, 0])


@pytest.mark.parametrize(
    ("excess", "reason"),
    [
        ([3e-3], None),
        ([0.4e-3], "near enough"),
        ([3e-3, 2e-3], None),
        ([3e-3, 2.9e-3], "no further gain"),
        ([3e-3, 2e-3, 1e-3], "turns used: 2"),
    ],
)
def test_when_it_stops(excess: list[float], reason: str | None) -> None:
    full_reason = stop_reason(StopRule(2, 0.5e-3, 0.1), excess)
    assert full_reason is None if reason is None else full_reason is not None and full_reason.startswith(reason)


@pytest.mark.parametrize(("truth", "believed"), [(8.0, 0.0), (-4.0, 4.0)])
def test_the_cloth_is_found_in_its_points_whatever_was_believed(truth: float, believed: float) -> None:
    true, rng = rolled_sheet(truth), np.random.default_rng(2)
    points = np.concatenate([NOISE.draw(Surface.of_faces(true), 600, rng) for _ in range(8)])
    faces = resting_faces(points, standard().fabric, rolled_sheet(believed))
    off = Surface.of_faces(faces).distance(true)
    assert np.sqrt(np.mean(off**2)) < 0.12e-3


def test_a_reduced_loop_on_the_rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulator and virtual rig, both coarse: two designs, the second by what the first one's trials taught."""
    from studies.rig import RigSession, run_rig
    from studies.rig.scene import Resolution

    restrict_effects(monkeypatch, "filling_lag", "orthotropy", "frame_tilt")
    key = 'format = "fabdesign.key/1"\n[parameters]\nmuscle_gain = 0.75\n'
    (tmp_path / "key.toml").write_text(f"{key}[sensing]\nframe_rate = 20.0\npoints = 300\n")
    design = build("cross")
    write_design(design, tmp_path / "start.toml")
    program = rising_program(HIDDEN, 0.3, 0.9)
    coarse = Resolution(element=0.04, step=1 / 240)
    run_rig(RigSession([(design, [program])], tmp_path / "key.toml", resolution=coarse), tmp_path / "hidden")
    np.savetxt(tmp_path / "target.xyz", np.concatenate(read_set(tmp_path / "hidden").trials[0].load().frames[-6:]))
    rig = f'[rig]\nkey = "key.toml"\nelement = 0.04\nstep = {1 / 240}\n'
    text = (
        STUDY.replace('[rig]\nkey = "key.toml"\n', rig)
        .replace("number = 3", "number = 3\nseconds = 0.4")
        .replace("turns = 1", "turns = 1\ngain = -10")
    )
    text = text.replace("points_per_side = 15", "points_per_side = 11\nrise = 0.3\nhold = 0.6").replace(
        "evaluations = 80", "evaluations = 40"
    )
    (tmp_path / "study.toml").write_text(text)
    outcome = run_loop(tmp_path / "study.toml", tmp_path / "out")
    first, second = (turn.device["excess"] for turn in outcome.turns if turn.device)
    assert second < 0.7 * first
    assert outcome.stop_reason.startswith(("turns used", "near enough"))
