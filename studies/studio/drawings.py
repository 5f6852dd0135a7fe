"""The drawings of a sitting, the own one with its history for undo and redo, and results of searches beside it; and
their shapes and motions as they are shown."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.surface import CAP, Surface, capped_rms
from fabdesign.nouns.array import Array
from fabdesign.units import in_mm
from studies.studio.layout import Layout
from studies.studio.opening import Comparison, scale_end
from studies.studio.solver import Correction

STEPS = 500  # that can be undone
APART = 1e-3  # m: surfaces nearer than that, drawn through each other, only flicker
_SCALED = 8  # frames that the end of a motion's scale is taken from


@dataclass(frozen=True, eq=False)
class LiveShape:
    """A shape at rest as it is shown. points: (2 n, 3) m. jump: m RMS, where it is another stable shape than the one
    before it."""

    points: NDArray[np.float32]
    layout: Layout
    exact: bool
    points_per_side: int
    seconds: float  # that it took
    jump: float | None = None
    time: float | None = None  # s after rest, of a motion's frame; None: at rest
    correction: Correction | None = None


@dataclass(frozen=True, eq=False)
class TrialMotion:
    """Frames (T, 2 n, 3) m at times (T,) s, and with them, where they were measured or are wanted, the clouds (n_t, 3)
    m. points: corrected where a corrector acts. off: (T,) m from what is wanted, NaN at instants at which nothing
    is: the cloud is then the next one that is."""

    name: str
    times: Array
    points: NDArray[np.float32]
    clouds: Sequence[NDArray[np.floating[Any]]] | None = None
    correction: Correction | None = None
    off: Array | None = None

    @cached_property
    def _moved(self) -> float:
        """Return m, the most by which a corrector moved a point."""
        return 0.0 if self.correction is None else float(self.correction.moved(self.points).max())

    def ghost(self, frame: int) -> NDArray[np.float32] | None:
        """Return a frame (2 n, 3) m before the corrector, where that is far enough off to be seen beside."""
        return None if self.correction is None or self._moved < APART else self.correction.simulated[frame]

    def cloud(self, frame: int) -> Array | None:
        """Return what was measured or is wanted of a frame, (n_t, 3) m."""
        return None if self.clouds is None else np.asarray(self.clouds[frame], dtype=np.float64)

    def distances(self, frame: int, *, corrected: bool = True) -> Array | None:
        """Return (n_t,) m from each of these points to the surface, as it is shown or before the corrector, capped at
        10 mm."""
        if (cloud := self.cloud(frame)) is None:
            return None
        points = self.points if corrected or self.correction is None else self.correction.simulated
        return np.minimum(Surface.of_faces(points[frame]).distance(cloud, within=CAP), CAP)

    @cached_property
    def largest(self) -> float | None:
        """Return the end [m] of the scale of distances, by frames spread over the motion; None where there are none."""
        frames = np.unique(np.linspace(0, len(self.times) - 1, _SCALED).astype(int)).tolist()
        of_frames = [distances for frame in frames if (distances := self.distances(frame)) is not None]
        return scale_end(np.concatenate(of_frames)) if of_frames else None

    def in_words(self, frame: int) -> str:
        text = f"{self.name}, {self.times[frame]:.3f} s"
        if self.off is not None:
            error, mean = in_mm(self.off[frame]), in_mm(float(np.nanmean(self.off)))
            now = f"{error:.2f} mm" if np.isfinite(error) else "not wanted at this instant"
            return f"{text}: surface RMS {now}, mean {mean:.2f} mm"
        shown = [
            self.distances(frame, corrected=corrected) for corrected in ((True, False) if self._moved else (True,))
        ]
        rms = [f"{in_mm(capped_rms(distances)):.2f} mm" for distances in shown if distances is not None]
        if not rms:
            return text
        return f"{text}: surface RMS " + " corrected, ".join(rms) + (" without the corrector" if self._moved else "")


@dataclass(eq=False)
class Seen:
    """A drawing whose last exact shape may be `live`, and how far that is from the target."""

    live: LiveShape | None = None
    comparison: Comparison | None = None

    def forget(self) -> None:
        """Drop both: they were under another model, or beside another target."""
        self.live = self.comparison = None


class DrawingHistory(Seen):
    """The drawing under edit, with undo and redo. A gesture (a drag, one move of a slider) is one step, however many
    layouts it passes through."""

    name, objective = "own drawing", None

    def __init__(self, layout: Layout) -> None:
        super().__init__()
        self._kept = layout
        self._steps, self._at = [("", layout)], 0  # what was done, and the layout after it
        self.gesture: tuple[str, Layout] | None = None  # what is under way, and where it is

    @property
    def layout(self) -> Layout:
        return (self.gesture or self._steps[self._at])[1]

    def at(self, pose: int) -> Layout:
        """Return the layout with a pose shown."""
        return self.layout.at(pose)

    @property
    def changed(self) -> bool:
        """Return whether design or pressures are others than those last saved or opened."""
        return not self.layout.same_content(self._kept)

    def do(self, what: str, layout: Layout) -> None:
        """Take one step to another layout; what was undone before is gone."""
        self.end()
        if layout != self.layout:
            self._steps = [*self._steps[: self._at + 1][-STEPS:], (what, layout)]
            self._at = len(self._steps) - 1

    def remove_pose(self, pose: int) -> None:
        """Take a pose out of the drawing and of every step."""
        self.end()
        self._kept = self._kept.without(pose)
        self._steps = [(what, layout.without(pose)) for what, layout in self._steps]

    def shape(self, what: str, layout: Layout) -> None:
        """Go through a moment of a gesture; another gesture ends where this one begins."""
        if self.gesture is not None and self.gesture[0] != what:
            self.end()
        self.gesture = what, layout

    def end(self) -> None:
        """Make the gesture under way, if any, one step."""
        if self.gesture is not None:
            gesture, self.gesture = self.gesture, None
            self.do(*gesture)

    def move(self, by: int) -> str | None:
        """Undo (-1) or redo (1) one step. Return its name, or None where there was none."""
        self.end()
        if not 0 <= self._at + by < len(self._steps):
            return None
        what = self._steps[max(self._at, self._at + by)][0]
        self._at += by
        return what

    @property
    def next_undo(self) -> str | None:
        return self._steps[self._at][0] if self._at else None

    def offer(self, what: str, layout: Layout) -> None:
        """Put a layout where redo finds it, before all else."""
        self._steps.insert(self._at + 1, (what, layout))

    def keep(self) -> None:
        """Take the drawing as it is now for saved."""
        self.end()
        self._kept = self.layout


@dataclass(eq=False)
class Result(Seen):
    """layouts: the best so far, one for each pose; at first where the search began. objective: m; None: none yet."""

    name: str = ""
    begun: Layout | None = None
    layouts: tuple[Layout, ...] = ()
    objective: float | None = None
    state: str = ""  # in words

    def at(self, pose: int) -> Layout:
        """Return the layout with a pose shown."""
        shown = self.layouts[min(pose, len(self.layouts) - 1)]
        by_pose = {k: layout.pressures for k, layout in enumerate(self.layouts)}
        return Layout(shown.design, {**by_pose, pose: shown.pressures}, pose)

    def hold(self, layouts: tuple[Layout, ...], objective: float) -> None:
        """Take a better result in."""
        if layouts != self.layouts:
            self.forget()
        self.layouts, self.objective = layouts, objective

    @property
    def muscles(self) -> int:
        return len(self.layouts[0].design.muscles)
