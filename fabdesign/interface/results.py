"""Results that are Python's alone: motions, sweeps, and what studies found in the units that a person types."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.errors import InputError, needs
from fabdesign.files.motion_file import MotionData
from fabdesign.formats.result_tables import Columns, Tabled
from fabdesign.formats.summary import Summary, muscle_columns
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import poses_in_words
from fabdesign.units import in_kpa, in_mm

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class Motion(MotionData, Tabled):
    """A motion: time (T,) s after rest, points (T, 3362, 3) m (front face, then back face). A shape at rest has one
    frame, at the end of its pressures. muscles: on the cloth. band: (T, 3, 3) m, how far 90 % of motions lie at most
    from it along its normal, in the mean of each of nine regions; None where the model has no intervals, or was not
    asked for them."""

    triangles: NDArray[np.intp] | None = None

    @property
    def faces(self) -> NDArray[np.float32]:
        """(T, face, row, column, 3) m: face 0 in front, 1 behind; rows from the top edge, columns from the left.

        >>> import numpy as np
        >>> Motion(np.zeros(5), np.zeros((5, 3362, 3), np.float32)).faces.shape
        (5, 2, 41, 41, 3)
        """
        side = round(float(np.sqrt(self.points.shape[1] / 2)))
        return self.points.reshape(len(self.points), 2, side, side, 3)

    @property
    def tension(self) -> NDArray[np.float32] | None:
        """(T, intervals) N, between the muscles' fixed points; `muscles.owners` says of which muscle each is. None
        where it is not known."""
        return None if self.muscles is None else self.muscles.tension

    @property
    def contraction(self) -> NDArray[np.float32] | None:
        """(T, intervals), 1 - l / l0 of the same intervals."""
        return None if self.muscles is None else self.muscles.contraction

    def to_array(self) -> xarray.DataArray:
        """Return `faces` with named axes: time [s], face, row, column, axis. Needs the extra `tables`."""
        try:
            import xarray
        except ModuleNotFoundError as error:
            raise InputError(needs(error)) from None
        names = ("time", "face", "row", "column", "axis")
        places = {"time": self.time, "face": ["front", "back"], "axis": ["x", "y", "z"]}
        return xarray.DataArray(self.faces, dims=names, coords=places, name="points", attrs={"units": "m"})

    def summary(self) -> Summary:
        """Return the number of frames and points, what box holds them, and the cloth at three instants."""
        from studies.report.oblique import wires_svg

        low, high = (end(self.points, axis=(0, 1)) for end in (np.min, np.max))
        head = (
            f"Motion: {len(self.time)} frames of {self.points.shape[1]} points, {self.time[0]:g} to {self.time[-1]:g} s"
        )
        instants = sorted({0, len(self.time) // 2, len(self.time) - 1})
        picture = wires_svg(self.faces[instants, 0])
        return Summary([head], {"axis": ["x", "y", "z"], "lowest m": low, "highest m": high}, [picture])

    def columns(self) -> Columns:
        """Return a row for every point of every frame: time [s], face, row, column, x, y, z [m]."""
        frames, faces, rows, columns, _ = self.faces.shape
        at = np.indices((frames, faces, rows, columns)).reshape(4, -1)
        x, y, z = self.points.reshape(-1, 3).T
        names = np.array(["front", "back"])
        return {"time": self.time[at[0]], "face": names[at[1]], "row": at[2], "column": at[3], "x": x, "y": y, "z": z}

    def to_json(self) -> dict[str, Any]:
        """Return how much there is of it."""
        return {"frames": len(self.time), "points": self.points.shape[1]}


@dataclass(frozen=True, eq=False)
class Sweep(Tabled):
    """Numbers of many shapes. pressures: of each design, (channels,) kPa at the end. values: (n,) of each output.
    complete: False where it was interrupted."""

    designs: tuple[Design, ...]
    pressures: tuple[NDArray[np.float64], ...]
    values: Mapping[str, NDArray[np.float64]]
    complete: bool

    def __getitem__(self, output: str) -> NDArray[np.float64]:
        """Return the values (n,) of an output."""
        return self.values[output]

    def __len__(self) -> int:
        return len(self.designs)

    def columns(self) -> Columns:
        """Return design, muscles, the pressure of each channel [kPa], and the outputs."""
        channels = max((len(row) for row in self.pressures), default=0)
        padded = np.full((len(self), channels), np.nan)
        for row, kpa in zip(padded, self.pressures, strict=True):
            row[: len(kpa)] = kpa
        return {
            "design": [design.name for design in self.designs],
            "muscles": [len(design.muscles) for design in self.designs],
            **{f"channel_{k}_kpa": padded[:, k] for k in range(channels)},
            **self.values,
        }

    def to_json(self) -> dict[str, Any]:
        """Return the columns."""
        return {**self.columns(), "complete": self.complete}


class _View(Tabled):
    """A study's result; what is not said otherwise here is the study's own, SI."""

    def __init__(self, result: Any) -> None:
        self.result = result

    def __getattr__(self, name: str) -> Any:
        if name == "result":  # while it is copied
            raise AttributeError(name)
        return getattr(self.result, name)

    def to_json(self) -> dict[str, Any]:
        """Return what result.json holds."""
        content: dict[str, Any] = self.result.as_json()
        return content


class Optimized(_View):
    """The result of a search: `studies.layouts.result.StudyResult` with pressures in kPa, and shapes as motions."""

    def summary(self) -> Summary:
        """Return error, pressures, muscles and the layout."""
        from fabdesign.drawings.layout_drawing import layout_svg

        head = f"Optimized: {in_mm(self.objective):.3f} mm after {len(self.history)} evaluations"
        poses, highest = self.result.pressures, self.study.limits.pressure[1]
        lines = [head, f"{self.search_time}; {self.stop_reason}", *self.reach.sentences, *poses_in_words(list(poses))]
        return Summary(lines, muscle_columns(self.design), [layout_svg(self.design, row, highest) for row in poses])

    @property
    def pressures(self) -> NDArray[np.float64]:
        """Return the pressures (poses, channels), kPa."""
        return in_kpa(self.result.pressures)

    @property
    def shapes(self) -> list[Motion]:
        """Return the shape of each pose, at rest or at its target's instant."""
        points = np.asarray(self.result.points, np.float32)
        return [Motion(np.array([t.time or 0.0]), p[None]) for t, p in zip(self.targets, points, strict=True)]

    def columns(self) -> Columns:
        """Return a row an evaluation of the search: its number, objective [mm], whether it diverged."""
        return {
            "evaluation": [*range(1, len(self.history) + 1)],
            "objective_mm": [in_mm(entry.objective) for entry in self.history],
            "diverged": [entry.diverged for entry in self.history],
        }


class Sensitivity(_View):
    """The result of a sweep: `studies.sensitivity.result.SensitivityResult` with indices by name."""

    def indices(self, output: str) -> dict[str, dict[str, Any]]:
        """Return first, total and their intervals of an output, by parameter. Raises InputError where there are
        none."""
        entry = self.to_json()["outputs"].get(output)
        if entry is None or "sobol" not in entry:
            known = ", ".join(column.name for column in self.result.columns)
            raise InputError(f"{output}: no indices; expected an output that varies, of {known}")
        indices: dict[str, dict[str, Any]] = entry["sobol"]
        return indices

    def columns(self) -> Columns:
        """Return a row an output and parameter: method, and each of its numbers."""
        return by_name(
            [
                {"output": output, "unit": entry["unit"], "parameter": name, "method": method} | _flat(numbers)
                for output, entry in self.to_json()["outputs"].items()
                for method in ("morris", "sobol")
                for name, numbers in entry.get(method, {}).items()
            ]
        )


class Layouts(_View):
    """The result of searches side by side: `studies.layout_grid.turns.GridResult`."""

    @property
    def front(self) -> list[Optimized]:
        """Return the cells that no other with as many muscles or fewer beats, by rising number of muscles."""
        return [Optimized(cell.result) for cell in self.result.front if cell.result is not None]

    def columns(self) -> Columns:
        """Return a row a cell: name, muscles, type, sides, the errors [mm] of the nearest layout that it may have, of
        which cell that is, muscles_used, front; and the study's outputs, a column for each pose."""
        rows = []
        for cell in self.to_json()["cells"]:
            poses = {
                name if len(output["values"]) == 1 else f"{name}, pose {pose}": value
                for name, output in cell.get("outputs", {}).items()
                for pose, value in enumerate(output["values"])
            }
            rows.append({name: value for name, value in cell.items() if not isinstance(value, list | dict)} | poses)
        return by_name(rows)


class Unseen(dict[str, Any], Tabled):
    """The content of `result.json` of a study of kind `unseen`."""

    __str__, __repr__ = Tabled.__str__, dict.__repr__

    def to_json(self) -> dict[str, Any]:
        """Return it without the middle lines, which are for the picture."""
        from studies.unseen.report import without_lines

        return {**without_lines(self)}  # type: ignore[arg-type]

    def columns(self) -> Columns:
        """Return a row a pose and output: pose, output, unit, and its 5, 50 and 95 % over the drawn models."""
        rows: list[dict[str, Any]] = []
        for number, pose in enumerate(self.get("poses") or []):
            values = [(f"tip_{axis}", "mm", ends) for axis, ends in pose["tip_mm"].items()]
            values.append(("mean_curvature", "1/m", pose["mean_curvature"]))
            values += [(name, output["unit"], output["percentiles"]) for name, output in pose["outputs"].items()]
            rows += [
                {"pose": number, "output": name, "unit": unit, "low90": low, "middle": middle, "high90": high}
                for name, unit, (low, middle, high) in values
            ]
        return by_name(rows)


def by_name(rows: Sequence[Mapping[str, Any]]) -> Columns:
    """Return columns of rows that may lack some."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return {name: [row.get(name, np.nan) for row in rows] for name in names}


def _flat(numbers: Mapping[str, Any]) -> dict[str, float]:
    flat: dict[str, float] = {}
    for name, value in numbers.items():
        if isinstance(value, Sequence):
            stem = name.removesuffix("interval90").removesuffix("_")
            flat |= {f"{stem}{'_' * bool(stem)}{side}90": x for side, x in zip(("low", "high"), value, strict=True)}
        else:
            flat[name] = value
    return flat
