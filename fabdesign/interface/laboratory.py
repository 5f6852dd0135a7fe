"""Measured data: fused from recordings, or made on the virtual rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from fabdesign.errors import InputError
from fabdesign.interface.run import Run, many_of
from fabdesign.interface.verb import Computing, DesignLike, File, Folder, Pressures, Shown, Working, verb

if TYPE_CHECKING:
    from studies.fusion.report import FusionReport


def _fused(reports: Sequence[FusionReport], given: Mapping[str, Any]) -> Shown:
    lines, count = [], len(given["recordings"])
    for report in reports:
        worst = max(sensor.residual_mm for sensor in report.sensors)
        of = "" if count == 1 else f" of {report.recording}"
        lines.append(
            f"{given['out']}: {report.frames} frames{of}, {len(report.sensors)} sensors within {worst:.2f} mm RMS of "
            "the cloth"
        )
        lines += [f"skipped: {what}" for what in report.skipped]
        if report.timing is not None:
            lost = sum(sensor.lost for sensor in report.timing.sensors.values())
            apart = max(abs(sensor.offset) for sensor in report.timing.sensors.values())
            lines.append(f"clocks up to {1e3 * apart:.1f} ms apart; {lost} images lost; report.html shows more")
    return Shown(reports[0] if count == 1 else {"trials": reports}, "\n".join(lines))


@verb(_fused, "RECORDING...", title="fused")
def fuse(
    recordings: Sequence[File] | File,
    out: Folder,
    *,
    points: int = 3362,
    per_frame: bool = False,
    convention: Literal["forward", "backward"] = "forward",
    skip_bad: bool = False,
    seed: int = 0,
    **given: Unpack[Working],
) -> tuple[FusionReport, ...]:
    """Make a measurement set from clouds or depth images of several sensors.

    The sensors of each RECORDING are registered and fused. Each RECORDING becomes a trial, in the order given. Cameras
    that stamp their images (RealSense recordings, folders of images, npz, MCAP) are laid on one time axis first.

    out: The measurement set to write.
    per_frame: Refine the sensors' poses for each frame.
    convention: Camera axes of the clouds: z forward and y down, or (x, -y, -z) as RealSense SDKs export.
    skip_bad: Leave out invalid frames and recordings, and list them.
    """
    from studies.fusion.fuse import FusionOptions, fuse_all

    run, many = Run(**given), [recordings] if isinstance(recordings, Path | str) else recordings
    return fuse_all(
        many,
        out,
        FusionOptions(points, per_frame, convention, skip_bad, seed),
        force=run.force,
        progress=lambda done, of: run.progress(f"fused {done} of {of} frames", done / of),
    )


def _measured(trials: int, given: Mapping[str, Any]) -> Shown:
    out, recording = str(given["out"]), given["recording"]
    content = {"set": out, "trials": trials, "recording": None if recording is None else str(recording)}
    return Shown(content, f"{out}: {trials} trials of a synthetic rig")


@verb(_measured, more={"more": "[P.csv]... [DESIGN P.csv...]..."}, hidden=("effects",), title="measured")
def rig(
    design: DesignLike,
    pressures: Sequence[Pressures] = (),
    out: Folder | None = None,
    *,
    more: Sequence[File] = (),
    key: File | None = None,
    recording: File | None = None,
    test_trials: int = 0,
    **given: Unpack[Computing],
) -> int:
    """Measure a DESIGN on a virtual rig.

    The rig is another simulator than that of `simulate`. It writes a measurement set. Several designs share one
    session; each is followed by its pressures: A.toml P1.csv P2.csv B.toml P3.csv.

    pressures: Pressures of the first design, one file per trial.
    out: The measurement set to write.
    key: Ground truth of the specimen; not written into the set.
    recording: Folder for the raw clouds of four depth cameras, of the first trial.
    test_trials: Number of last trials that get the role test.

    more: what follows on the command line. Returns the number of trials.
    """
    from studies.rig import RigSession, run_rig

    if out is None:
        raise InputError("rig: no output; expected the measurement set to write")
    run, session = Run(**given), [(design, [*many_of("pressures", pressures)])]
    for file in map(str, more):
        if file.lower().endswith(".toml"):
            session.append((Path(file), []))
        else:
            session[-1][1].append(file)
    for one, programs in session:
        if not programs:
            raise InputError(f"{one}: no pressures; expected a program after it, or --pressures for the first design")
    with run.computing():
        run_rig(
            RigSession(session, key, test_trials),
            out,
            recording=recording,
            force=run.force,
            progress=lambda done, of: run.progress(f"measured {done} of {of} trials", done / of),
            say=run.say,
        )
    return sum(len(programs) for _, programs in session)
