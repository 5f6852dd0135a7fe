"""The files that the studio is opened on: a design, a study, a measurement set, with a target or pressures beside it.
Where a target lies, how far the cloth is from it; and one that moves, with a program."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.cloud_file import KINDS
from fabdesign.clouds.target_file import AS_GIVEN, AsTarget, keys_as_options
from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design
from fabdesign.files.measurement_set import MeasurementSet, read_set
from fabdesign.files.model_file import read_model
from fabdesign.files.pressure_file import read_pressures
from fabdesign.formats.json_file import read_json
from fabdesign.formats.toml_file import file_stem, parse_toml
from fabdesign.geometry.distances import nearest_distances
from fabdesign.geometry.metrics import Errors, beyond_in_words
from fabdesign.nouns.array import Array
from fabdesign.nouns.catalogue import build
from fabdesign.nouns.design import Design
from fabdesign.nouns.model import Model
from fabdesign.nouns.pressure import PressureProgram, limits
from fabdesign.output import read_mark
from fabdesign.study_files.follow_file import FollowStudy
from fabdesign.study_files.study_file import read_head, read_study
from optimize.search.margins import Limits
from studies.follow import Regulator, Wanted, regulator_of, wanted_of
from studies.layout_search.target import LoadedTarget, load_target, target_errors
from studies.prediction.predict import frame_times
from studies.studio.layout import HIGHEST, Layout
from studies.view import errors_in_words

DRAWS = 5  # of a floor: it stands beside each exact shape, and is good to a few hundredths of a millimetre
FRAME_RATE = 30.0  # Hz, of a motion that is played
POINTS = 500  # of each cloud of a target that moves
LEAST_SCALE = 0.002  # m, the least end of a scale of distances


def scale_end(distances: Array) -> float:
    """Return the end [m] of a scale of distances (n,) m: their 98th percentile, LEAST_SCALE at least."""
    return max(LEAST_SCALE, float(np.percentile(distances, 98)))


@dataclass(frozen=True, eq=False)
class Comparison:
    """A shape against the target. Distances in m."""

    errors: Errors
    of_cloth: Array  # (2 m,) of each point of the cloth to the nearest of the target

    @staticmethod
    def of(target: LoadedTarget, shape: NDArray[np.float32], design: Design) -> "Comparison":
        """Return how far a shape (2 n, 3) m is from a target."""
        errors = target_errors([target], shape[None].astype(np.float64), design, draws=DRAWS)
        return Comparison(errors, nearest_distances(shape, target.points))

    @cached_property
    def largest(self) -> float:
        """Return the end [m] of the scale of distances."""
        return scale_end(self.of_cloth)

    @property
    def sentences(self) -> list[str]:
        """Return the errors in words, mm, with the noise floors beside."""
        beyond = [beyond_in_words(self.errors.beyond)] if self.errors.beyond else []
        return [*errors_in_words(self.errors).split(", "), *beyond]


@dataclass(frozen=True, eq=False)
class MovingProgram:
    """A study of a target that moves, and set points (cycles, channels) Pa for it."""

    study: FollowStudy
    wanted: Wanted
    regulator: Regulator
    pressures: Array

    @staticmethod
    def of(study: FollowStudy) -> "MovingProgram":
        """Return the study under the program that it begins with, or at rest. Raises InputError."""
        if not study.design.muscles:
            raise InputError(f"{study.name}: no layout yet; expected the folder of the study's result")
        wanted, regulator = wanted_of(study).thinned(POINTS), regulator_of(study)
        rest = np.zeros((regulator.cycles(float(wanted.times[-1])), regulator.channels))
        moving = MovingProgram(study, wanted, regulator, rest)
        return moving if study.start is None else moving.under(study.start)

    def under(self, program: PressureProgram) -> "MovingProgram":
        """Return the same under another program, as far as the regulator goes with it."""
        return replace(self, pressures=self.regulator.kept(self.regulator.rows(program, len(self.pressures))))

    @cached_property
    def times(self) -> Array:
        """Return the instants (T,) s that are shown: those that are wanted, and others where they are far apart."""
        wanted = self.wanted.times
        between = frame_times(self.regulator.program(self.pressures), frame_rate=FRAME_RATE)[1:]
        apart = np.abs(between[:, None] - wanted).min(axis=1) > 0.5 / FRAME_RATE
        return np.sort(np.concatenate([wanted, between[apart & (between < wanted[-1])]]))

    @cached_property
    def clouds(self) -> list[Array]:
        """Return what is wanted at each of these instants, or next (n_t, 3) m."""
        return [self.wanted.targets[k].points for k in np.searchsorted(self.wanted.times, self.times - 1e-9)]


NEW = Path("layout.toml")  # that a layout would be, which was begun on no file
_BEGUN = "design, study or set"


@dataclass(frozen=True, eq=False)
class Opened:
    """file: the design's, which is watched and beside which an autosave lies; it need not be there."""

    file: Path
    layout: Layout
    limits: Limits
    targets: tuple[LoadedTarget, ...] = ()  # poses of one layout
    model_file: Path | None = None
    model: Model | None = None
    measured: MeasurementSet | None = None
    program: PressureProgram | None = None
    moving: MovingProgram | None = None  # of a study of a target that moves

    @staticmethod
    def of(
        file: Path, design: Design, pressures: tuple[float, ...] = (), limits: Limits | None = None, **more: Any
    ) -> "Opened":
        """Return a design; without limits under those that a search keeps where no study says."""
        return Opened(file, Layout.of(design, pressures), limits or search_limits(design), **more)


def open_files(files: Sequence[Path], model_file: Path | None, how: AsTarget = AS_GIVEN) -> Opened:
    """Open a design, study or set, at most one of them (none: the catalogue's *basic*), and beside it at most one
    target and one table of pressures. how: that target is read. Raises InputError."""
    by_kind: dict[str, Path] = {}
    for file in dict.fromkeys(files):
        if (kind := _kind(file)) in by_kind:
            raise InputError(f"{file}: a second {kind} beside {by_kind[kind]}; expected one")
        by_kind[kind] = file
    if how != AS_GIVEN and "target" not in by_kind:
        raise InputError("--unit, --place or --rotation without a target; expected a cloud or mesh among the files")
    opened = _begun(by_kind[_BEGUN]) if _BEGUN in by_kind else Opened.of(NEW, build("basic", name="layout"))
    design, more = opened.layout.design, dict[str, Any]()
    if model_file is not None:
        more |= {"model_file": model_file, "model": read_model(model_file)}
    if "target" in by_kind:
        with keys_as_options():
            more["targets"] = (load_target(how.target(by_kind["target"]), design),)
    if "pressures" in by_kind:
        program = read_pressures(by_kind["pressures"], design)
        more["layout"] = Layout.of(design, _last(program))
        more |= {"program": program} if opened.moving is None else {"moving": opened.moving.under(program)}
    return replace(opened, **more)


def _last(program: PressureProgram) -> tuple[float, ...]:
    return tuple(map(float, program.pressure[-1]))


def _kind(file: Path) -> str:
    """Return what a file is for."""
    suffix = file.suffix.lower()
    if file.is_dir() or file.name == "set.toml":
        return _BEGUN
    if suffix == ".toml":
        text = str(parse_toml(file).get("format", "fabdesign.design/1"))
        if text.partition("/")[0] in ("fabdesign.design", "fabdesign.study"):
            return _BEGUN
        raise InputError(
            f"{file}: format {text}; expected a design, a study or a measurement set (--model for a model)"
        )
    if suffix == ".csv":
        head = file.read_text(encoding="utf-8", errors="replace")[:8] if file.is_file() else ""
        return "pressures" if head.startswith("time_s") else "target"
    if suffix in KINDS:
        return "target"
    raise InputError(f"{file}: expected a design, study, set, target (cloud or mesh) or pressures (CSV)")


def _begun(file: Path) -> Opened:
    """Return what the design, study, set or result of a study holds."""
    if (mark := read_mark(file)) is not None and mark.made_by == "follow":
        study = read_json(file / "result.json").get("study")
        if not isinstance(study, str):
            raise InputError(f"{file}: of a study without a file; expected the result of a study's file")
        return _of_moving(file / study, file)
    if file.is_dir() or file.name == "set.toml":
        measured = read_set(file)
        first = measured.trials[0]
        name = Path(file_stem(f"{measured.name}_{first.design_name}") + ".toml")  # nothing is written into a set
        return Opened.of(name, first.design, measured=measured)
    root = parse_toml(file)
    if not str(root.get("format", "")).startswith("fabdesign.study"):
        design, last = read_design(file), tuple[float, ...]()
        if file.name == "design.toml":
            with suppress(InputError):  # none lie beside it, or those of another design
                last = _last(read_pressures(file.with_name("pressures.csv"), design))
        return Opened.of(file, design, last)
    kind = read_head(file).kind
    if kind == "follow":
        return _of_moving(file)
    if kind != "optimize":
        raise InputError(f'{file}: kind = "{kind}"; expected "optimize" or "follow", a search with a target')
    search, (design_file, model_file) = read_study(file), _files_of(file)
    begin = search.start_pressures
    pressures = np.full(search.design.channels, np.mean(search.limits.pressure)) if begin is None else begin
    targets = tuple(load_target(target, search.design) for target in search.targets)
    with_model = {"model_file": model_file, "model": search.model}
    begun = tuple(map(float, pressures))
    return Opened.of(design_file, search.design, begun, limits=search.limits, targets=targets, **with_model)


def _of_moving(file: Path, result: Path | None = None) -> Opened:
    """Return a study of a target that moves; with the folder of a result its layout, where one was searched for, and
    its pressures."""
    study, (design_file, model_file) = FollowStudy.read(file), _files_of(file)
    if result is not None and (result / "design.toml").is_file():
        design_file = result / "design.toml"
        study = replace(study, design=read_design(design_file))
    moving = MovingProgram.of(study)
    if result is not None:
        moving = moving.under(read_pressures(result / "pressures.csv", study.design))
    return Opened.of(design_file, study.design, model_file=model_file, model=study.model, moving=moving)


def _files_of(file: Path) -> tuple[Path, Path | None]:
    """Return the files of a study's design and model."""
    root = parse_toml(file)
    return file.parent / str(root["design"]), file.parent / str(root["model"]) if "model" in root else None


def search_limits(design: Design) -> Limits:
    """Return what a search keeps where no study says: pressures up to HIGHEST or the lowest maximum of the muscles."""
    return Limits(pressure=(0.0, float(min([HIGHEST, *limits(design)]))))
