"""What a motion takes, estimated before it is begun: too much of it is bad input, told in a line at once."""

from collections.abc import Iterator, Sequence

from fabdesign.errors import InputError

MEMORY = 2e9  # bytes that a command may need beyond those of the program itself
LONGEST = 3600.0  # s, of a pressure program or a motion
COARSEST, FINEST = 9, 161  # grid points a side
CLOSEST = 0.001  # m between fixed points: stitches are not made closer
MUSCLES = 256  # of a design
_TICKS = 1920  # steps in a second at most
_FACES, _NODE = 120_000, 21  # bytes of a frame: its two faces of 41 x 41 points on the way out, and of each node
_MEANS = 48  # bytes of a channel's pressure while the steps are laid out
_SCHEME = 12 * 4  # bytes of a step's rule


def frame_bytes(points_per_side: int) -> float:
    """Of one frame of a motion on a grid, at the peak (measured with 41 and 161 points a side)."""
    return _FACES + _NODE * points_per_side**2


def step_bytes(channels: int) -> float:
    """Of a step of one motion."""
    return _SCHEME + channels * (4 + _MEANS)


def require_motion(seconds: float, frames: float, points_per_side: int, *, channels: int = 0, where: str = "") -> None:
    """Raise InputError where a motion of `seconds` s, all its `frames` kept, would last or take too much."""
    at = f"{where}: " if where else ""
    if seconds > LONGEST:
        raise InputError(f"{at}a motion of {seconds:g} s; expected at most {LONGEST:g} s")
    memory = frames * frame_bytes(points_per_side) + seconds * _TICKS * step_bytes(channels)
    if memory > MEMORY:
        raise InputError(
            f"{at}{frames:.7g} frames in {seconds:g} s with {points_per_side} grid points a side take "
            f"{memory / 1e9:.2g} GB; expected at most {MEMORY / 1e9:g} GB: a shorter time or fewer frames a second"
        )


def batches(frames: Sequence[int], at_once: int) -> Iterator[slice]:
    """Motions with so many `frames` each, in order: at most `at_once` together, and of more than one no more frames
    than memory holds on the finest grid."""
    most, first = MEMORY / 2 / frame_bytes(FINEST), 0
    while first < len(frames):
        end = first + 1
        while end < min(len(frames), first + at_once) and sum(frames[first : end + 1]) <= most:
            end += 1
        yield slice(first, end)
        first = end
