"""The items that are looked at: motions, trials, clouds and predictions, each as frames of points with their times. And
how far the shapes of two are apart, with the noise floor: what side by side alone does not say."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isqrt
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fabdesign.clouds.cloud_file import POINTS
from fabdesign.clouds.target_file import AS_GIVEN, AsTarget
from fabdesign.errors import InputError
from fabdesign.files.design_file import read_design
from fabdesign.files.measurement_set import read_set
from fabdesign.files.motion_file import Motion, read_motion, square_triangles
from fabdesign.files.trial_file import TrialData, read_trial
from fabdesign.formats.npz_file import open_npz
from fabdesign.geometry.distances import chamfer
from fabdesign.geometry.metrics import Errors, frame_errors, mean_errors
from fabdesign.geometry.sensor_noise import NOISE_FREE, SensorNoise, estimate_noise
from fabdesign.geometry.shape import LacedMuscles, Shape
from fabdesign.geometry.surface import Surface
from fabdesign.nouns.array import Array
from fabdesign.nouns.forward import Case, ForwardModel
from fabdesign.nouns.model import Model
from fabdesign.nouns.trial import Trial
from fabdesign.output import read_mark
from fabdesign.units import in_mm
from studies.prediction.forward_model import laced_motions, sensed_model

LARGEST = 5.0  # m, of any coordinate: what is larger is in another unit
MOST = 8  # side by side


@dataclass(frozen=True, eq=False)
class Item:
    """One panel. frames: a sequence of T arrays (n_t, 3) m; times (T,) s, of which a still shape has one."""

    title: str
    times: NDArray[np.float64]
    frames: Any
    triangles: NDArray[np.intp] | None = None  # (t, 3), of all frames alike; None: a cloud
    size: tuple[float, float] | None = None  # m, of the flat cloth; None: not known
    muscles: LacedMuscles | None = None
    predicts: str = ""  # title of the panel that this one predicts
    apart: "Distance | None" = None  # from the panel that it is compared with

    @staticmethod
    def of_motion(title: str, motion: Motion, predicts: str = "") -> "Item":
        return Item(title, motion.time, motion.points, motion.triangles, motion.size, motion.muscles, predicts)

    @cached_property
    def is_cloth(self) -> bool:
        """Return whether points and triangles are two square faces, as the simulator gives them."""
        count = len(self.frames[0])
        if self.triangles is None or count < 8 or 2 * isqrt(count // 2) ** 2 != count:
            return False
        return np.array_equal(self.triangles, square_triangles(count))

    @property
    def moves(self) -> bool:
        return len(self.times) > 1

    def nearest(self, time: float) -> int:
        """Return the frame that is shown at `time` [s]."""
        return int(np.argmin(np.abs(self.times - time)))


def items_of(
    files: Sequence[Path],
    *,
    trial: str | None = None,
    design: Path | None = None,
    model: Model | None = None,
    forward: ForwardModel | None = None,
    how: AsTarget = AS_GIVEN,
) -> list[Item]:
    """Return the panels of files: a motion's npz, a trial's npz, a measurement set (its `trial` by name, by default the
    first), a cloud or mesh. With a model, each trial's prediction by `forward` follows it, simulated and corrected
    where the model has a corrector; a lone trial needs its `design`. how: clouds and meshes are read.

    Raises InputError for what cannot be shown.
    """
    items: list[Item] = []
    for file in files:
        if file.is_dir() and not (file / "set.toml").is_file():
            raise InputError(_no_set(file))
        if file.is_dir() or file.name == "set.toml":
            items += _of_set(file, trial, model, forward)
        elif file.suffix.lower() == ".npz" and (kind := _kind(file)) != "cloud":
            if kind == "motion":
                items.append(Item.of_motion(file.stem, read_motion(file)))
            elif design is not None:
                hung = read_design(design)
                one = Trial(file, hung.name, hung, order=0, role="fit")
                items += _trial(one, file.stem, "measured", model, forward)
            elif model is not None:
                raise InputError(f"{file}: a lone trial; expected --design with its design file to predict it")
            else:
                items.append(_measured(f"{file.stem}, measured", read_trial(file)))
        else:
            shape = how.read(file)
            if np.abs(shape.points).max() > LARGEST:
                raise InputError(f"{file.name}: points are beyond {LARGEST:g} m; expected metres, or --unit")
            items.append(Item(file.name, np.zeros(1), shape.points[None], shape.triangles if shape.is_mesh else None))
    if len(items) > MOST:
        raise InputError(f"{len(items)} panels; expected at most {MOST} side by side")
    for item in items:
        if any(np.abs(frame).max(initial=0.0) > LARGEST for frame in item.frames):
            raise InputError(f"{item.title}: points are beyond {LARGEST:g} m; expected metres")
    return items


def _no_set(folder: Path) -> str:
    """Return that a folder is no set, what it is, and what of it can be looked at."""
    mark, wanted = read_mark(folder), "a motion, a measurement set, a trial, a cloud or a mesh"
    if mark is None:
        return f"{folder}: a folder without set.toml; expected {wanted}"
    design, pressures, page = (folder / name for name in ("design.toml", "pressures.csv", "report.html"))
    looked = [f"{page} shows it"] if page.is_file() else []
    if design.is_file() and pressures.is_file():
        motion = f"fabdesign simulate {design} --pressures {pressures} -o MOTION.npz"
        looked.append(f"its motion, to view, comes from: {motion}")
    elif motions := sorted(folder.rglob("*.npz")):
        looked.append(f"{motions[0]} can be viewed")
    what = f"{folder}: holds what fabdesign {mark.made_by} made, no measurement set"
    return f"{what}; {'; '.join(looked)}" if looked else f"{what}; expected {wanted}"


def _kind(file: Path) -> str:
    with open_npz(file, "a motion's or a trial's arrays") as arrays:
        return "trial" if "offsets" in arrays else "motion" if "time" in arrays else "cloud"


def _of_set(file: Path, name: str | None, model: Model | None, forward: ForwardModel | None) -> list[Item]:
    """Return the panels of a trial of a set by its name, else of the first."""
    measured = read_set(file)
    chosen = [t for t in measured.trials if name in (None, t.name)]
    if not chosen:
        known = ", ".join(t.name for t in measured.trials[:5])
        raise InputError(f"{file}: has no trial {name}; expected one of {known}, ...")
    source = "synthetic rig" if "synthetic" in measured.description else "measured"
    title = f"{measured.name}/{chosen[0].name} ({chosen[0].design_name})"
    return _trial(chosen[0], title, source, model, forward)


def _measured(title: str, data: TrialData) -> Item:
    return Item(title, np.asarray(data.time, np.float64), data.frames)


def _trial(trial: Trial, name: str, source: str, model: Model | None, forward: ForwardModel | None) -> list[Item]:
    items = [_measured(f"{name}, {source}", trial.load())]
    if model is not None and forward is not None:
        case = Case(trial.design, trial.program, order=trial.order)
        shown = {"predicted": model}
        if model.corrector is not None:
            shown = {"simulated": model.without(["corrector"]), "corrected": model}
        for what, part in shown.items():
            motion = laced_motions(sensed_model(forward, part), [case], [trial.times])[0]
            if not np.isfinite(motion.points).all():
                raise InputError(f"{trial.file}: its prediction diverges; expected a model under which it can be shown")
            items.append(Item.of_motion(f"{name}, {what}", motion, items[0].title))
    return items


def timeline(items: Sequence[Item]) -> NDArray[np.float64]:
    """Return (T,) s, rising: the instants of the panel with the most frames, at each of which the others show the
    nearest."""
    return max(items, key=lambda item: len(item.times)).times


INSTANTS = 40  # of a motion, at most
_NOISE_FRAMES = 8  # that a sensor's noise is estimated from
_FEWEST = 800  # points of a cloth's cloud, under which a curved cloth looks like noise


@dataclass(frozen=True, eq=False)
class Distance:
    """The distance from a panel to the one it is compared with, at `times` (K,) s. NaN in errors: not known."""

    reference: str
    times: Array
    errors: tuple[Errors, ...]  # m
    both_move: bool
    json_keys: ClassVar = (
        ("from", "reference"),
        ("of", lambda of: of.when or "still shapes"),
        ("unit", lambda of: "mm"),
        ("**", lambda of: of.overall.millimetres()),  # null: not known
    )

    @property
    def overall(self) -> Errors:
        """Return the errors of the motion: the mean of two that move, else the last."""
        return mean_errors(self.errors) if self.both_move else self.errors[-1]

    @property
    def when(self) -> str:
        """Return what `overall` is of; empty between still shapes."""
        return "" if len(self.times) == 1 else "mean of the motion" if self.both_move else "at the motion's end"


def errors_in_words(errors: Errors) -> str:
    """Return the distances in words."""
    floors = np.isfinite(errors.chamfer_floor)

    def figure(value: float, floor: float) -> str:
        return f"{in_mm(value):.2f} mm" + (f" (noise floor {in_mm(floor):.2f})" if floors else "")

    text = f"Chamfer {figure(errors.chamfer, errors.chamfer_floor)}"
    if np.isfinite(errors.surface_rms):
        text += f", surface RMS {figure(errors.surface_rms, errors.surface_floor)}"
    return text


def compared(items: Sequence[Item]) -> list[Item]:
    """Return the panels with how far each is apart from the first one, a prediction from what it predicts; those that
    others are compared with are apart from none."""
    by_title = {item.title: item for item in items}
    references = [by_title.get(item.predicts, items[0]) for item in items]
    return [
        item if item is reference else replace(item, apart=_distance(reference, item))
        for item, reference in zip(items, references, strict=True)
    ]


def _distance(reference: Item, item: Item) -> Distance:
    both_move = item.moves and reference.moves
    times = item.times if item.moves or not reference.moves else reference.times
    times = times[np.unique(np.linspace(0, len(times) - 1, min(INSTANTS, len(times))).astype(int))]
    pairs = [(_frame(reference, t), _frame(item, t)) for t in times]
    if not item.is_cloth and not reference.is_cloth:
        errors = [
            Errors(chamfer(*(p[:: -(-len(p) // POINTS)] for p in pair)), np.nan, np.nan, np.nan) for pair in pairs
        ]
        return Distance(reference.title, times, tuple(errors), both_move)
    seen, model = zip(*(pair if item.is_cloth else pair[::-1] for pair in pairs), strict=True)
    source = reference if item.is_cloth else item
    noise = NOISE_FREE if source.triangles is not None else _noise(seen, model[0])
    errors = frame_errors(seen, np.array(model), noise or NOISE_FREE)
    if noise is None:
        errors = [Errors(e.chamfer, np.nan, e.surface_rms, np.nan) for e in errors]
    return Distance(reference.title, times, tuple(errors), both_move)


def _frame(item: Item, time: float) -> Array:
    """Return (n, 3) m: its points as a sensor would give them; of a mesh that is no cloth even draws over its area."""
    points = np.asarray(item.frames[item.nearest(time)], np.float64)
    if item.triangles is None or item.is_cloth:
        return points
    return Surface(points, item.triangles).sample(POINTS, np.random.default_rng(0))[0]


def _noise(clouds: Sequence[Array], model: Array) -> SensorNoise | None:
    """Return the noise of the sensor that saw a cloth; None where the clouds have too few points to say."""
    if np.median([len(cloud) for cloud in clouds]) < _FEWEST:
        return None
    front, back = Shape.of(model).faces
    thickness = float(np.median(np.linalg.norm(front - back, axis=-1)))
    chosen = np.unique(np.linspace(0, len(clouds) - 1, min(_NOISE_FRAMES, len(clouds))).astype(int))
    try:
        return estimate_noise([clouds[k] for k in chosen], thickness)
    except InputError:
        return None
