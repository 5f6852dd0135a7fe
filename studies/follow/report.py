"""The folder of a study of a moving target: numbers and a page."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fabdesign.files.motion_file import square_triangles
from fabdesign.formats.json_file import plain
from fabdesign.units import in_kpa, in_mm
from fabdesign.version import __version__
from studies.follow.result import FollowResult
from studies.report import charts, page
from studies.study import write_result
from studies.view import Item, render_page

_FRAMES = 90  # of the moving picture, at most


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
