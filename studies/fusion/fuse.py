"""`fabdesign fuse`: raw clouds or depth images of several sensors become a measurement set, a trial a recording.

Every sensor is registered to the cloth at rest, all of them jointly to one another over all frames; then each frame is
thinned on a grid, face by face, and sampled. docs/lab/fuse.md has the figures.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fabdesign.clouds.recording import Convention, Recording, read_recording
from fabdesign.errors import InputError
from fabdesign.files.measurement_set import NewTrial, write_set
from fabdesign.formats.json_file import write_json
from fabdesign.nouns.design import Design
from fabdesign.output import new_folder
from fabdesign.runtime import working_time
from studies.fusion.frames import Fusion, FusionReport
from studies.measured.splits import Tolerance

if TYPE_CHECKING:
    from studies.fusion.input import AlignedFrames

POINTS = 3362  # a frame, as many as 41 x 41 points on two faces


@dataclass(frozen=True)
class FusionOptions:
    """How recordings are fused. points: a frame. per_frame: refine the poses for each frame on its own, from the shared
    ones. convention: of the clouds' axes (see read_recording). skip_bad: leave out what is unsound, also a whole
    recording among several, and list it, instead of raising."""

    points: int = POINTS
    per_frame: bool = False
    convention: Convention = "forward"
    skip_bad: bool = False
    seed: int = 0


def fuse(recording: Path | str | Recording, out: Path | str, *, force: bool = False, **given: Any) -> FusionReport:
    """Fuse a recording into the measurement set `out`: one trial of order 0. given: FusionOptions."""
    return fuse_all([recording], out, FusionOptions(**given), force=force)[0]


def fuse_all(
    recordings: Sequence[Path | str | Recording],
    out: Path | str,
    options: FusionOptions = FusionOptions(),
    *,
    force: bool = False,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> tuple[FusionReport, ...]:
    """Fuse recordings into the measurement set `out`: a trial each, role fit, its order its place among those given.
    Recordings of equal designs share one. A report on each trial.

    force: replace a set that this program made. progress is told a recording's frames done and in all. Raises
    InputError.
    """
    skip_bad = options.skip_bad
    if options.points < 2:
        raise InputError(f"points = {options.points}; expected at least 2")
    _require_open3d()
    given = [r if isinstance(r, Recording) else read_recording(r, convention=options.convention) for r in recordings]
    if not given:
        raise InputError("fuse: no recordings; expected at least one")
    folders = [recording.folder.resolve() for recording in given]
    if (twice := next((folder for folder in folders if folders.count(folder) > 1), None)) is not None:
        raise InputError(f"{given[folders.index(twice)].folder}: is given twice; expected every recording once")
    keys, designs = _designs(given)
    reports: dict[int, FusionReport] = {}
    skipped: list[str] = []  # of recordings that are left out whole

    def trials(folder: Path) -> Iterator[NewTrial]:
        for order, recording in enumerate(given):
            tolerance = Tolerance(skip_bad)
            try:
                fusion, report = fused_recording(recording, tolerance, options, progress)
            except InputError as error:
                line = str(error) if len(given) == 1 else f"recording {recording.folder}: {error}"
                if len(given) == 1 or not skip_bad:
                    raise InputError(line) from None
                skipped.append(line)
                continue
            reports[order] = replace(report, order=order)
            fusion.draw(folder, "" if len(given) == 1 else f"_{order:03d}", report)
            yield NewTrial(f"{order:03d}", keys[order], order, "fit", fusion.data(), report.timing)
        if not reports:
            raise InputError(f"{given[0].folder}: no recording is left; {skipped[0]}")

    with new_folder(out, made_by="fuse", force=force, inputs=[r.folder for r in given]) as unfinished:
        names = f"fused from the recording{'s' * (len(given) > 1)} {', '.join(r.name for r in given)}"
        write_set(unfinished, designs, trials(unfinished), name=Path(out).resolve().name, description=names)
        first = min(reports)
        reports[first] = replace(reports[first], skipped=(*skipped, *reports[first].skipped))
        done = tuple(reports.values())
        write_json(unfinished / "fusion.json", done[0] if len(given) == 1 else {"trials": done})
    return done


def _designs(recordings: Sequence[Recording]) -> tuple[list[str], dict[str, Design]]:
    """Return each recording's key in the set's designs, and these: equal ones once, another of one name as NAME_2."""
    keys, designs = [], dict[str, Design]()
    for design in (recording.design for recording in recordings):
        names = (f"{design.name}_{number}" if number > 1 else design.name for number in count(1))
        keys.append(next(name for name in names if designs.setdefault(name, design) == design))
    return keys, designs


def fused_recording(
    recording: Recording, tolerance: Tolerance, options: FusionOptions, progress: Callable[[int, int], None]
) -> tuple[Fusion, FusionReport]:
    """Return a fused recording. Raises InputError."""
    started = working_time.seconds()
    target = dict[str, float]()
    if recording.depth:
        from studies.fusion.stamped import stamped_frames
        from studies.fusion.targets import upright, with_target_poses

        recording, target = with_target_poses(recording)
        aligned: AlignedFrames = stamped_frames(upright(recording), tolerance)
    else:
        from studies.fusion.input import plain_frames

        aligned = plain_frames(recording, tolerance)
    fusion = Fusion(aligned, options.points, options.per_frame, options.seed)
    for done, (index, time, views) in enumerate(aligned.frames(), start=1):
        with tolerance.forgiving():
            fusion.add(index, time, views)
        progress(done, len(aligned.times))
    if not fusion.frames:
        raise InputError(f"recording {recording.name}: no sound frame is left")
    skipped = tuple(filter(None, (recording.left_out, *tolerance.skipped)))
    return fusion, fusion.report(skipped, working_time.seconds() - started, target)


def _require_open3d() -> None:
    try:
        import_module("open3d")
    except ImportError:
        raise InputError("fuse needs the package open3d; pip install fabdesign[clouds]") from None
    except OSError as error:
        raise InputError(
            f"open3d does not load ({error}); on Debian: apt install libx11-6 libgl1 libegl1 libusb-1.0-0"
        ) from None
