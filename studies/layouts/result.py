"""The result of a study, its files, and how the history of its search keeps it, so that the same call answers at once;
and what makes two calls the same."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Literal, get_type_hints

import numpy as np

from fabdesign.files.design_file import write_design
from fabdesign.files.motion_file import Motion
from fabdesign.files.pressure_file import SINGLE_ROW_DURATION, constant_program, pressure_file_of, write_pressures
from fabdesign.formats.json_file import exact, of_exact, write_json
from fabdesign.formats.result_tables import Columns, Summary, Tabled, muscle_columns
from fabdesign.geometry.metrics import Errors
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.forward import RISE
from fabdesign.nouns.pressure import poses_in_words, regulated, rising_program
from fabdesign.runtime.fingerprint import content_of
from fabdesign.study_files.study_file import Study
from fabdesign.units import in_kpa, in_mm
from fabdesign.version import SIMULATOR, __version__
from optimize.search.evaluations import SLOPES, TIME_USED
from optimize.search.history import Entry, History
from optimize.search.multistart import INTERRUPTED
from optimize.search.objective import MEASURES
from optimize.search.search_state import of_row
from optimize.search.thinning import Fewer
from studies.layout_search.target import LoadedTarget, pose_errors
from studies.layouts.loading_path import LoadingPath
from studies.layouts.reach import Reach
from studies.layouts.refinement import fewer_in_words, kept_fewer
from studies.layouts.robustness import Robustness


@dataclass(frozen=True, eq=False)
class StudyResult(Tabled):
    """Distances in m, pressures in Pa. Poses are the study's targets, in their order."""

    study: Study
    design: Design
    pressure: Array  # (poses, channels) Pa
    targets: tuple[LoadedTarget, ...]
    points: Array  # (poses, 2 n, 3) m, the result's shapes: front face, then back face
    rest: Array  # (2 n, 3) m, the same cloth without pressure
    errors: Errors  # mean over the poses
    rest_errors: Errors  # its floors from a single draw
    constraints: dict[str, float]  # least margin of every limit, m (Pa for pressure)
    history: tuple[Entry, ...]
    wall_s: float  # of the search, earlier sessions included
    stop_reason: str
    reach: Reach
    loading_path: LoadingPath | None  # None where the motion to the result was not followed
    robust: Robustness | None = None  # where the study asks for it
    within: float | None = None  # m, half of a 90 % interval along the normal; None: the model has no intervals
    fewer: Fewer | None = None  # what leaving muscles out came to, where their number may vary
    kept: bool = False  # whether it was there before, and nothing was searched
    json_keys: ClassVar = (  # `surface_beyond` of the errors is a share of the points
        ("objective_mm", "objective"),
        ("**", "errors"),
        ("evaluations", lambda of: len(of.history)),
        ("diverged", lambda of: sum(entry.diverged for entry in of.history)),
        "wall_s", ("limit_s", "study.limits.seconds"), "design.muscles",
        ("pressures_kpa", lambda of: of.pressure if len(of.pressure) > 1 else of.pressure[0]),
        ("constraints", lambda of: {k: in_kpa(v) if k == "pressure" else v for k, v in of.constraints.items()}),
        "stop_reason", ("expected_within_mm", "within"), ("poses", lambda of: of._poses()),
        ("outputs", "output_values"), "reach", ("way", "loading_path"), ("after_a_tenth_mm", "after_a_tenth"), "robust",
        ("fewer", lambda of: of.fewer and of._fewer(of.fewer)), "study.seed",
        ("targets", lambda of: [target.description for target in of.targets]),
    )  # fmt: skip

    @property
    def pressures(self) -> Array:
        """Return (poses, channels) kPa, as Python's functions take them."""
        return in_kpa(self.pressure)

    @property
    def shapes(self) -> list[Motion]:
        """Return the shape of each pose, at rest or at its target's instant."""
        points = np.asarray(self.points, np.float32)
        return [Motion(np.array([t.time or 0.0]), p[None]) for t, p in zip(self.targets, points, strict=True)]

    def summary(self) -> Summary:
        """Return error, pressures, muscles and the layout."""
        from fabdesign.drawings.layout_drawing import layout_svg

        head = f"Optimized: {in_mm(self.objective):.3f} mm after {len(self.history)} evaluations"
        lines = [head, f"{self.search_time}; {self.stop_reason}", *self.reach.sentences]
        layouts = [layout_svg(self.design, row, self.study.limits.pressure[1]) for row in self.pressure]
        return Summary([*lines, *poses_in_words([*self.pressure])], muscle_columns(self.design), layouts)

    def columns(self) -> Columns:
        """Return a row an evaluation of the search: its number, objective [mm], whether it diverged."""
        return {
            "evaluation": [*range(1, len(self.history) + 1)],
            "objective_mm": [in_mm(entry.objective) for entry in self.history],
            "diverged": [entry.diverged for entry in self.history],
        }

    @property
    def search_time(self) -> str:
        """Return in words the time searched against its limit, both without compiling and loading, and what goes on
        where earlier calls have used the limit up."""
        spent = f"{self.wall_s:.0f} of at most {self.study.limits.seconds:g} s of search time (without compilation)"
        if not self.kept or self.reach.lacking is None:
            return spent
        limit = "--seconds" if self.stop_reason.startswith(TIME_USED) else "limit"
        return f"{spent}, all in earlier calls on this folder, which count together: a larger {limit} goes on"

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C ended the search."""
        return self.stop_reason.startswith(INTERRUPTED)

    @property
    def objective(self) -> float:
        """Return m, of the measure that was searched."""
        return MEASURES[self.study.objective].errors(self.errors)[0]

    @property
    def floor(self) -> float:
        """Return what noise and sampling allow of that measure, m."""
        return MEASURES[self.study.objective].errors(self.errors)[1]

    @property
    def after_a_tenth(self) -> float | None:
        """Return m, the best after a tenth of the study's seconds; None before the first evaluation."""
        within = 0.1 * self.study.limits.seconds
        shapes = [e for e in self.history if not e.diverged and not e.stage.endswith(SLOPES)]
        early = [e.objective for e in shapes if e.seconds <= within]
        return min(early, default=None)

    @property
    def outputs(self) -> dict[str, list[str]]:
        """Return what the study asks for of the result's shapes, by name: of each pose, with its unit."""
        every = self.output_values.items()
        return {name: [f"{value:.1f} {of['unit']}" for value in of["values"]] for name, of in every}

    @property
    def output_values(self) -> dict[str, Any]:
        """Return them with `unit` and `values`."""
        return {
            output.text: {"unit": output.unit, "values": [output.of(points) for points in self.points]}
            for output in self.study.outputs
        }

    def _poses(self) -> list[dict[str, float]]:
        """Return the errors of each pose where there are several."""
        if len(self.targets) == 1:
            return []
        each = pose_errors(self.targets, self.points, seed=self.study.seed)
        return [
            errors.millimetres() | {"weight": target.weight} for errors, target in zip(each, self.targets, strict=True)
        ]

    def _fewer(self, fewer: Fewer) -> dict[str, Any]:
        return {
            "muscles": len(fewer.start[0].design.muscles),
            "of": fewer.count,
            "before_mm": in_mm(fewer.before),
            "tolerance": self.study.price.tolerance,
            "channels": fewer.start[0].channels,
            "front": [{"muscles": count, "objective_mm": in_mm(value)} for count, value in fewer.front],
            "said": self.fewer_in_words,
        }

    @property
    def fewer_in_words(self) -> str:
        """Return how many muscles serve, in words; empty where their number is given."""
        if self.fewer is None:
            return ""
        words = fewer_in_words(self.study, self.fewer, converged=self.reach.lacking is None)
        front = ", ".join(f"{count}: {in_mm(value):.2f}" for count, value in self.fewer.front)
        return f"{words} Reached, in mm, by number of muscles: {front}." if len(self.fewer.front) > 1 else words

    @property
    def within_in_words(self) -> str | None:
        """Return the expected deviation in words."""
        if self.within is None:
            return None
        return (
            f"What is sewn is expected within {in_mm(self.within):.2f} mm of this shape (90 %, along the cloth's "
            "normal, mean over its regions)."
        )

    def write(self, out: Path) -> None:
        """Write `design.toml` with its bench tables, `pressures.csv` (`pressures_2.csv` of a second pose),
        `result.json`."""
        write_best(out, self.design, self.pressure, self, [t.time for t in self.targets], self.study.rise)


def write_best(
    out: Path,
    design: Design,
    pressures: Array,
    result: Any,
    times: list[float | None],
    rise: float = RISE,
) -> None:
    """Write a design, each pose's pressures [Pa], held until its time [s] or, to a shape at rest, rising within `rise`
    s, and result.json, each file whole."""
    write_design(design, out / "design.toml")
    for pose, (row, time) in enumerate(zip(regulated(pressures), times, strict=True), start=1):
        file = pressure_file_of(pose)
        program = (
            rising_program(row, rise, rise + SINGLE_ROW_DURATION)
            if time is None
            else constant_program(row, time or SINGLE_ROW_DURATION)
        )
        write_pressures(program, out / file)
    write_json(out / "result.json", result)


VERSIONS = f"fabdesign {__version__}, simulator {SIMULATOR}"
_MADE_AGAIN = ("study", "design", "pressure", "targets", "history", "fewer", "kept")
_KEPT = [field.name for field in fields(StudyResult) if field.name not in _MADE_AGAIN]  # as they are
_RAISED = ("limits.seconds", "limits.evaluations")  # without another result up to there
STARTS_OF_POSES = 2  # raised where a search of several poses no longer begins where it did, so that none goes on
_NO_MATTER = ("name", "targets", "outputs")  # the targets' points count, not their files
_ABSENT = ("limits.contraction", "limits.channels", "limits.air")  # where there is no such limit


def study_content(study: Study, targets: Sequence[LoadedTarget]) -> dict[str, str]:
    """Return field (`limits.spacing`, `design.fabric.thickness`, `target.points`) to value, as text; pressures in
    kPa."""
    more: dict[str, Any] = {"limits.pressure": [in_kpa(pressure) for pressure in study.limits.pressure]}
    if len(targets) > 1:
        more["starts"] = STARTS_OF_POSES
    if study.start_pressures is not None:
        more["start_pressures"] = in_kpa(study.start_pressures).tolist()
    for number, target in enumerate(targets, start=1):
        name = "target" if len(targets) == 1 else f"target {number}"
        more |= {f"{name}.time": target.time, f"{name}.weight": target.weight, f"{name}.points": target.sha256}
        further = {
            "distances": target.markers and "from markers, one way",
            "wishes": target.landmarks and target.landmarks.key,
            "free": target.free,
            "regions": target.weighting and repr(target.weighting.regions),
            "face": target.face != "both" and target.face,
        }
        more |= {f"{name}.{key}": value for key, value in further.items() if value}
    content = content_of(study, _NO_MATTER, more).items()
    return {name: value for name, value in content if name not in _RAISED and (name not in _ABSENT or value != "None")}


# of the layout that a search ended with: its shape at rest alone, or the motion that leads there too
Verification = Literal["at rest", "motion"]


def keep(history: History, result: StudyResult) -> None:
    """Let the same call answer with this result: what it has beside its study, targets and history, the limits that it
    was searched within, and whether a search within wider ones would end alike (`complete`)."""
    study, state = result.study, history.load()
    if state is None:
        return
    kept = {
        "versions": VERSIONS,
        "seconds": study.limits.seconds,
        "evaluations": study.limits.evaluations,
        "complete": bool(state.get("reason")) and study.robust is None and not (result.fewer and result.fewer.cut),
        "follow": result.loading_path is not None,
        "layout": {"muscles": result.design.muscles, "pressures": result.pressure.tolist()},
    }
    history.keep_answer(exact(kept | {name: getattr(result, name) for name in _KEPT}))


def answer(
    history: History, study: Study, targets: Sequence[LoadedTarget], verification: Verification
) -> StudyResult | None:
    """Return the result that is kept, where a search within the study's limits would end with it; None where it may
    not."""
    kept, limits, kinds = history.answer(), study.limits, get_type_hints(StudyResult)
    try:
        as_far = kept["seconds"] >= limits.seconds and kept["evaluations"] >= limits.evaluations
        if (
            kept["versions"] != VERSIONS
            or kept["follow"] != (verification == "motion")
            or not (kept["complete"] or as_far)
        ):
            return None
        space, _ = of_row(kept["layout"], study.design, study.limits)
        values = {name: of_exact(kinds[name], kept[name]) for name in _KEPT}
    except (KeyError, TypeError, ValueError, AttributeError):  # none, or of another version
        return None
    return StudyResult(
        study=study,
        design=space.design,
        pressure=space.start_pressures,
        targets=tuple(target.beside(shape) for target, shape in zip(targets, values["points"], strict=True)),
        history=tuple(history.entries()),
        **values,
        fewer=kept_fewer(study, history.load()),
        kept=True,
    )
