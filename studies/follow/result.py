"""The result of a study of a moving target, its page, and how certain its motion is: with other pressures and models,
and where small changes lead to another stable shape."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from fabdesign.files.motion_file import square_triangles
from fabdesign.formats.json_file import plain
from fabdesign.formats.schema import Key, Millimetre
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import NORMAL90
from fabdesign.nouns.model_sampling import Ensemble
from fabdesign.nouns.pressure import PressureProgram, limits
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.units import in_kpa, in_mm
from fabdesign.version import __version__
from studies.follow.programs import Regulator
from studies.follow.wanted import Wanted
from studies.prediction.forward_model import forward_model
from studies.prediction.stability import instants_elsewhere, rms_of_each, to_either_side
from studies.report import charts, page
from studies.study import write_result
from studies.view import Item, render_page

AT_LIMIT = 0.5  # of a resolution: so near a limit is at it
OUT_OF_REACH = 2.0  # times the floor, from which on a reason is sought
FLOORLESS = 0.5e-3  # m, the same of a target without noise
_FRAMES = 90  # of the moving picture, at most


@dataclass(frozen=True, eq=False)
class MotionCopies:
    """Motions beside the one that is meant. band (K,) m: half of the 90 % interval of the copies, RMS over the cloth.
    expected: m, the mean of their distances from what is wanted. snap: s, from when on small changes of the pressures
    lead to another stable shape; None where they do not."""

    number: int
    band: Annotated[Array, Key("")]
    snap: Annotated[float | None, Key("snap_s")]
    expected: Annotated[Millimetre, Key("expected_mm")]


@dataclass(frozen=True)
class Limitation:
    """Why the motion lacks something between two instants [s]."""

    begin: Annotated[float, Key("from_s")]
    end: Annotated[float, Key("to_s")]
    by: Literal["highest", "lowest", "rate", "reach"]  # the first two are limits of pressure
    channels: tuple[int, ...] = ()
    json_keys: ClassVar = (
        "begin", "end", ("by", lambda of: of.by if of.by in ("rate", "reach") else "pressure"), "channels"
    )  # fmt: skip

    @property
    def so_far(self) -> str:
        """Return it of a motion whose windows are not all solved, which says nothing of what the layout can reach."""
        if self.by != "reach":
            return self.sentence
        return f"from {self.begin:.2f} to {self.end:.2f} s the shape is not reached so far"

    @property
    def sentence(self) -> str:
        """Return it for people."""
        when = f"from {self.begin:.2f} to {self.end:.2f} s"
        if self.by == "reach":
            return f"{when} the layout does not reach the shape, or not so fast: no limit of the regulator is met"
        several = len(self.channels) > 1
        which = f"channel{'s' * several} {', '.join(map(str, self.channels))} {'are' if several else 'is'}"
        what = {"highest": "at the highest pressure", "lowest": "at the lowest pressure, after falling to it"}
        return f"{when} {which} {what.get(self.by, 'as fast as the regulator changes')}"


@dataclass(frozen=True, eq=False)
class FollowResult:
    """pressures (cycles, channels) Pa; motion (K, 2 n, 3) m at the wanted instants; errors: of each of them. begun: the
    mean surface RMS [m] of the program taken from shapes at rest alone. run: which repetition this is, 0 for none."""

    study: FollowStudy
    wanted: Wanted
    regulator: Regulator
    pressures: Array
    motion: NDArray[np.floating[Any]]
    errors: Sequence[Errors]
    begun: float
    copies: MotionCopies | None
    complete: bool
    seconds: float
    run: int = 0
    measured_error: float | None = None  # m, of the measured motion that was fed back
    json_keys: ClassVar = (
        "study.name",
        ("design", "study.design.name"),
        ("cycle_s", "regulator.cycle"),
        ("cycles", lambda of: len(of.pressures)),
        ("instants", lambda of: len(of.wanted.times)),
        ("error_mm", lambda of: of.rms.mean()),
        ("floor_mm", lambda of: of.floor.mean()),
        ("chamfer_mm", lambda of: np.mean([error.chamfer for error in of.errors])),
        ("from_rest_mm", "begun"),
        ("by_time.time_s", "wanted.times"), ("by_time.error_mm", "rms"), ("by_time.floor_mm", "floor"),
        ("by_time.band_mm", "copies.band"),
        ("limited", "limitations"), "copies", ("largest_kpa", lambda of: of.pressures.max(axis=0)),
        "complete", ("repetition", "run"), ("measured_error_mm", "measured_error"),
        "study.seed", "study.points_per_side", ("wall_s", "seconds"), ("said", "sentences"),
    )  # fmt: skip

    @property
    def program(self) -> PressureProgram:
        return self.regulator.program(self.pressures)

    @property
    def rms(self) -> Array:
        """Return the surface RMS (K,) m, of wishes the mean distance."""
        return np.array([error.surface_rms for error in self.errors])

    @property
    def floor(self) -> Array:
        """Return the noise floor (K,) m."""
        return np.array([error.surface_floor for error in self.errors])

    @property
    def limitations(self) -> list[Limitation]:
        """Return where the motion is off by more than noise, and why."""
        far = self.rms > np.maximum(OUT_OF_REACH * self.floor, FLOORLESS)
        times = self.wanted.times
        spans: list[Limitation] = []
        for k in np.flatnonzero(far):
            by, channels = self._met(float(times[k]))
            before = float(times[k - 1]) if k else 0.0
            last = spans[-1] if spans else None
            if last is not None and (last.by, last.channels, last.end) == (by, channels, before):
                spans[-1] = Limitation(last.begin, float(times[k]), by, channels)
            else:
                spans.append(Limitation(before, float(times[k]), by, channels))
        return spans

    def _met(self, time: float) -> tuple[Literal["highest", "lowest", "rate", "reach"], tuple[int, ...]]:
        """Return which limit a set point meets in the cycles before an instant. A channel that was idle all the time
        holds nothing back, unless all are."""
        regulator, last = self.regulator, int(np.ceil(time / self.regulator.cycle - 1e-9))
        rows = self.pressures[max(0, last - 4) : last]
        room = AT_LIMIT * regulator.resolution
        low, high = rows <= regulator.lowest + room, rows >= regulator.highest - room
        fallen = low[-1:] & (~low[:1] | low.all())
        steps = np.abs(np.diff(np.concatenate([np.zeros((1, regulator.channels)), self.pressures]), axis=0))
        fast = steps[max(0, last - 4) : last] >= regulator.change - regulator.resolution - room
        limits: dict[Literal["highest", "lowest", "rate"], NDArray[np.bool_]] = {}
        limits |= {"rate": fast, "highest": high, "lowest": fallen}
        for by, met in limits.items():
            if (channels := np.flatnonzero(met.any(axis=0))).size:
                return by, tuple(channels.tolist())
        return "reach", ()

    @property
    def sentences(self) -> list[str]:
        """Return what limits the motion, and how sure it is, for people."""
        lines = [one.sentence if self.complete else one.so_far for one in self.limitations]
        if self.copies is not None and (snap := self.copies.snap) is not None:
            lines.append(f"near a snap at {snap:.2f} s: pressures that differ by 2 % then lead to another stable shape")
        if not self.complete:
            lines.append("the time was used before all windows were solved; the same command goes on")
        return lines


def as_text(result: FollowResult) -> str:
    """Return what is printed."""
    head = (
        f"{in_mm(float(result.rms.mean())):.3f} mm over {len(result.wanted.times)} instants (noise floor "
        f"{in_mm(float(result.floor.mean())):.3f}; {in_mm(result.begun):.3f} by pressures of shapes at rest), "
        f"{len(result.pressures)} set points a channel, {result.seconds:.0f} s"
    )
    lines = [head, *result.sentences]
    if result.measured_error is not None:
        lines.insert(
            1, f"the measured motion was off by {in_mm(result.measured_error):.3f} mm; run these pressures next"
        )
    return "\n".join(lines)


def copies_of(study: FollowStudy, simulator: ForwardModel, case: Case, wanted: Wanted) -> MotionCopies | None:
    """Return what copies of the case's motion come to, each with pressures off by the channel, and a model of the
    covariance where there is one. None where none is asked for, or the motion itself diverges."""
    scatter, model = study.scatter, study.model
    if not scatter.copies:
        return None
    times, most = wanted.times, limits(case.design)
    rng = np.random.default_rng(study.seed)
    gains = 1 + scatter.pressure * rng.standard_normal((scatter.copies, len(most)))
    factors = [np.ones(len(most)), *to_either_side(case.design), *gains]
    programs = [replace(case.program, pressure=np.clip(case.program.pressure * row, 0.0, most)) for row in factors]
    cases = [replace(case, program=program) for program in programs]
    forward = forward_model(simulator, model)
    drawn = [] if model is None else Ensemble(model).drawn(scatter.copies, study.seed)
    alike = cases[: len(cases) - len(drawn)]
    meant, up, down, *copies = forward.motions(alike, [times] * len(alike))
    for one, drawn_case in zip(drawn, cases[len(alike) :], strict=True):
        copies += forward_model(simulator, one).motions([drawn_case], [times])
    sound = [copy for copy in copies if np.isfinite(copy).all()]
    if not np.isfinite(meant).all() or not sound:
        return None
    off = np.array([rms_of_each(copy - meant) for copy in sound])
    elsewhere = instants_elsewhere(meant, up, down)
    snap = float(times[int(np.argmax(elsewhere))]) if elsewhere.any() else None
    expected = float(np.mean([wanted.mean_distance(copy) for copy in sound]))
    return MotionCopies(len(sound), np.asarray(NORMAL90 * np.sqrt(np.square(off).mean(axis=0))), snap, expected)


def write_report(result: FollowResult, out: Path, study: str | None) -> None:
    """Write `result.json` and `report.html` into `out`. study: its file, from the folder that these come to."""
    write_result(out, {"study": study} | plain(result), result.study.name, _blocks(result))


def _blocks(result: FollowResult) -> Iterator[page.Block]:
    study, rms, floor = result.study, result.rms, result.floor
    yield page.Title(study.name, 1)
    yield page.Text(
        f"{page.mm(float(rms.mean()))} mm from what is wanted (noise floor {page.mm(float(floor.mean()))} mm), the "
        f"mean of {len(rms)} instants. Pressures of shapes at rest alone come to {page.mm(result.begun)} mm.",
        "verdict",
    )
    yield from page.texts("note", map(page.sentence, result.sentences))
    yield page.Title("Wanted and predicted")
    yield page.MotionBlock(_motion(result))
    yield page.Title("Error over time")
    times = result.wanted.times
    curves = [
        charts.curve("error", times, in_mm(rms), charts.BLUE),
        charts.curve("noise floor", times, in_mm(floor), charts.GREY),
    ]
    if result.copies is not None:
        curves.append(charts.curve("90 % band of copies", times, in_mm(result.copies.band), charts.RED))
    yield charts.chart("error", curves, x="time, s", y="mm", yaxis={"rangemode": "tozero"})
    yield page.Title("Pressures")
    instants = result.regulator.cycle * np.arange(len(result.pressures) + 1)
    rows = in_kpa(np.concatenate([result.pressures, result.pressures[-1:]]))
    steps = [charts.curve(f"channel {c}", instants, values, line_shape="hv") for c, values in enumerate(rows.T)]
    yield charts.chart("pressures", steps, x="time, s", y="pressure, kPa", yaxis={"rangemode": "tozero"})
    if result.copies is not None:
        number, expected = result.copies.number, page.mm(result.copies.expected)
        drawn = " and a model drawn from the covariance each" if study.model and study.model.covariance else ""
        yield page.Text(
            f"The band is that of {number} copies, {expected} mm off in the mean, with pressures "
            f"{100 * study.scatter.pressure:g} % off{drawn}.",
            "quiet",
        )
    yield page.Text(
        f"{study.points_per_side} grid points a side, seed {study.seed}, {result.seconds:.0f} s. "
        f"fabdesign {__version__}.",
        "quiet",
    )


def _motion(result: FollowResult) -> str:
    times = result.wanted.times
    frames = np.unique(np.linspace(0, len(times) - 1, min(_FRAMES, len(times))).round().astype(int))
    wanted = [result.wanted.targets[int(k)].points for k in frames]
    motion = result.motion[frames].astype(np.float32)
    items = [
        Item("wanted", times[frames], wanted),
        Item("predicted", times[frames], motion, square_triangles(motion.shape[1])),
    ]
    return render_page(result.study.name, items)
