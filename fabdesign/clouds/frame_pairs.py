"""Which clouds of several cameras belong to one frame, by their stamps: a lost message shifts nothing."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_SHORTEST = 1e6  # ns between frames; what lies closer is no stamp of a camera
_REPEATED = 0.5  # of the interval: a message that follows so soon repeats the one before
_TOGETHER = 0.75  # of the interval: farther apart, two clouds are not of one frame


@dataclass(frozen=True, eq=False)
class FramePairs:
    """The frames of a recording in the order of their stamps."""

    clouds: NDArray[np.intp]  # (T, sensors) the number of each sensor's cloud; -1: it has none of this frame
    time: NDArray[np.float64]  # (T,) s after the first frame
    repeated: int  # messages that were left out since they repeat the one before
    interval: float  # s between frames, the median

    @property
    def whole(self) -> NDArray[np.bool_]:
        """Return (T,) whether every sensor has a cloud."""
        return np.asarray((self.clouds >= 0).all(axis=1))


def pair_frames(stamps: Sequence[NDArray[np.int64]]) -> FramePairs | None:
    """Pair clouds by their stamps [ns], an array for each sensor in the order of its messages.

    None where the stamps say nothing: too few, alike, or of clocks that do not agree.
    """
    if min(map(len, stamps)) < 2:
        return None
    first = min(int(times.min()) for times in stamps)
    seconds = [times - first for times in stamps]
    gaps = np.concatenate([np.diff(np.unique(times)) for times in seconds])
    interval = float(np.median(gaps)) if len(gaps) else 0.0
    if interval < _SHORTEST:
        return None
    kept = []
    for times in seconds:
        numbers: list[int] = []
        for number in np.argsort(times, kind="stable"):
            if not numbers or times[number] - times[numbers[-1]] > _REPEATED * interval:
                numbers.append(int(number))
        kept.append(numbers)
    reference = int(np.argmax([len(numbers) for numbers in kept]))
    at = seconds[reference][kept[reference]]
    frames = [{reference: number} for number in kept[reference]]
    unpaired: list[dict[int, int]] = []
    for sensor, numbers in enumerate(kept):
        if sensor == reference:
            continue
        times = seconds[sensor][numbers]
        nearest = _nearest(times, at)
        mutual = _nearest(at, times)[nearest] == np.arange(len(times))
        paired = mutual & (np.abs(times - at[nearest]) < _TOGETHER * interval)
        for number, frame, both in zip(numbers, nearest, paired, strict=True):
            if both:
                frames[frame][sensor] = number
            else:
                unpaired.append({sensor: number})
    if len(stamps) > 1 and 2 * sum(len(frame) == len(stamps) for frame in frames) < len(frames):
        return None
    frames = sorted(frames + unpaired, key=lambda frame: min(seconds[s][n] for s, n in frame.items()))
    clouds = np.array([[frame.get(sensor, -1) for sensor in range(len(stamps))] for frame in frames])
    time = np.array([np.mean([seconds[s][n] for s, n in frame.items()]) for frame in frames]) * 1e-9
    repeated = sum(map(len, stamps)) - sum(map(len, kept))
    return FramePairs(clouds, np.round(time - time[0], 6), repeated, interval * 1e-9)


def _nearest(of: NDArray[np.int64], among: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return of each stamp the number of the nearest of others. Both rise."""
    after = np.clip(np.searchsorted(among, of), 1, max(len(among) - 1, 1))
    after = np.minimum(after, len(among) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(of - among[before] <= among[after] - of, before, after)


def left_out_line(pairs: FramePairs, topics: Sequence[str], times: NDArray[np.float64], where: str) -> str:
    """Return a line on the frames that are left out since a sensor lost them, and on what stands twice; "" for none."""
    lost = [f"{topics[column]} at {times[k]:.3g} s" for k, column in np.argwhere(pairs.clouds < 0)]
    shown = f" (no cloud on {', '.join(lost[:3])}{', ...' * (len(lost) > 3)})" if lost else ""
    counts = f"{int((~pairs.whole).sum())} of {len(times)} frames are left out{shown}"
    line = f"{where}: by the stamps {counts}, and {pairs.repeated} clouds that repeat the one before"
    return line if lost or pairs.repeated else ""
