"""Results: arrays, and the same as tables, files and arrays with named axes where the extra `tables` is there."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.errors import InputError, needs
from fabdesign.model import Model
from fabdesign.summary import Summary
from fabdesign.units import in_mm

if TYPE_CHECKING:
    import pandas
    import xarray

    from studies.calibration.calibrate import Calibration
    from studies.evaluate import SetEvaluation
    from studies.tracing.outcome import Outcome
    from studies.training.train import TrainingResult


Columns = dict[str, "list[Any] | NDArray[Any]"]  # by name, all of one length


class Tabled:
    """A result that can be a table, and shows itself in some lines."""

    def summary(self) -> Summary:
        """Return what `print` and a notebook show."""
        return Summary([f"{type(self).__name__}:"], self.columns())

    def __str__(self) -> str:
        return self.summary().text()

    def _repr_html_(self) -> str:
        return self.summary().html()

    def columns(self) -> Columns:
        """Of the table, by name: sequences of the same length. Units are those of the command's output."""
        raise NotImplementedError

    def to_table(self) -> "pandas.DataFrame":
        """Needs the extra `tables`."""
        try:
            import pandas
        except ModuleNotFoundError as error:
            raise _extra(error) from None
        return pandas.DataFrame(dict(self.columns()))

    def to_parquet(self, path: Path | str) -> None:
        """The table as a Parquet file."""
        self.to_table().to_parquet(path, index=False)


@dataclass(frozen=True, eq=False)
class Motion(Tabled):
    """A motion: time (T,) s after rest, points (T, 3362, 3) m (front face, then back face). A shape at rest has one
    frame, at the end of its pressures. band: (T, 3, 3) m, how far 90 % of motions lie at most from it along its normal,
    in the mean of each of nine regions; None where the model has no intervals, or was not asked for them."""

    time: NDArray[np.float64]
    points: NDArray[np.float32]
    band: NDArray[np.float64] | None = None

    @property
    def faces(self) -> NDArray[np.float32]:
        """(T, face, row, column, 3) m: face 0 in front, 1 behind; rows from the top edge, columns from the left.

        >>> import numpy as np
        >>> Motion(np.zeros(5), np.zeros((5, 3362, 3), np.float32)).faces.shape
        (5, 2, 41, 41, 3)
        """
        side = round(float(np.sqrt(self.points.shape[1] / 2)))
        return self.points.reshape(len(self.points), 2, side, side, 3)

    def to_array(self) -> "xarray.DataArray":
        """`faces` with named axes: time [s], face, row, column, axis. Needs the extra `tables`."""
        try:
            import xarray
        except ModuleNotFoundError as error:
            raise _extra(error) from None
        names = ("time", "face", "row", "column", "axis")
        places = {"time": self.time, "face": ["front", "back"], "axis": ["x", "y", "z"]}
        return xarray.DataArray(self.faces, dims=names, coords=places, name="points", attrs={"units": "m"})

    def summary(self) -> Summary:
        """Return the number of frames and points, and what box holds them."""
        low, high = (end(self.points, axis=(0, 1)) for end in (np.min, np.max))
        head = (
            f"Motion: {len(self.time)} frames of {self.points.shape[1]} points, {self.time[0]:g} to {self.time[-1]:g} s"
        )
        return Summary([head], {"axis": ["x", "y", "z"], "lowest m": low, "highest m": high})

    def columns(self) -> Columns:
        """A row for every point of every frame: time [s], face, row, column, x, y, z [m]."""
        frames, faces, rows, columns, _ = self.faces.shape
        at = np.indices((frames, faces, rows, columns)).reshape(4, -1)
        x, y, z = self.points.reshape(-1, 3).T
        names = np.array(["front", "back"])
        return {"time": self.time[at[0]], "face": names[at[1]], "row": at[2], "column": at[3], "x": x, "y": y, "z": z}


@dataclass(frozen=True, eq=False)
class Sweep(Tabled):
    """Numbers of many shapes. pressures: of each design, (channels,) kPa at the end. values: (n,) of each output.
    complete: False where it was interrupted."""

    designs: tuple[Design, ...]
    pressures: tuple[NDArray[np.float64], ...]
    values: Mapping[str, NDArray[np.float64]]
    complete: bool

    def __getitem__(self, output: str) -> NDArray[np.float64]:
        """(n,) of an output."""
        return self.values[output]

    def __len__(self) -> int:
        return len(self.designs)

    def columns(self) -> Columns:
        """design, muscles, the pressure of each channel [kPa], and the outputs."""
        channels = max((len(row) for row in self.pressures), default=0)
        padded = np.full((len(self), channels), np.nan)
        for row, kpa in zip(padded, self.pressures, strict=True):
            row[: len(kpa)] = kpa
        own = {f"channel_{k}_kpa": padded[:, k] for k in range(channels)}
        return {
            "design": [design.name for design in self.designs],
            "muscles": [len(design.muscles) for design in self.designs],
            **own,
            **self.values,
        }


@dataclass(frozen=True, eq=False)
class Calibrated(Tabled):
    """found: all that the fit says. skipped: bad trials left out, a line each."""

    found: "Calibration"

    @property
    def model(self) -> Model:
        return self.found.model

    @property
    def skipped(self) -> tuple[str, ...]:
        return self.found.skipped

    def columns(self) -> Columns:
        """name, value, unit, low90, high90, scope of every parameter."""
        return _of_model(self.model)


@dataclass(frozen=True, eq=False)
class Traced(Tabled):
    """found: all that the trace says."""

    found: "Outcome"

    def summary(self) -> Summary:
        """Return the verdict, and the model's parameters."""
        return Summary([f"Traced: {self.verdict}"], self.columns())

    @property
    def verdict(self) -> str:
        """ "effect", "adequate" or "unexplained"."""
        return str(self.found.verdict)

    @property
    def model(self) -> Model:
        return self.found.model

    def columns(self) -> Columns:
        """name, value, unit, low90, high90, scope of every parameter of the model."""
        return _of_model(self.model)


@dataclass(frozen=True, eq=False)
class Trained(Tabled):
    """model: the file that was written, its weights beside it. found: all that training says."""

    model: Path
    found: "TrainingResult"
    skipped: tuple[str, ...]

    def columns(self) -> Columns:
        """Errors in mm of each design that was held out: design, trials, then each error before and after."""
        held = self.found.as_json()["held_out"]
        columns: Columns = {"design": [*held], "trials": [of["trials"] for of in held.values()]}
        for when in ("before", "after"):
            for name in sorted({name for of in held.values() for name in of[when]}):
                columns[f"{name}_{when}"] = [of[when].get(name, np.nan) for of in held.values()]
        return columns


@dataclass(frozen=True, eq=False)
class Evaluated(Tabled):
    """found: errors before and after, by design. skipped: bad trials left out, a line each."""

    found: "SetEvaluation"
    skipped: tuple[str, ...]

    def columns(self) -> Columns:
        """A row a trial: design, set, trial, order, role, share of frames used, and errors before and after [mm]."""
        tables = (*self.found.designs.items(), *self.found.others.items())
        rows = [(name, trial) for name, table in tables for trial in table.trials]
        columns: Columns = {"design": [name for name, _ in rows]}
        for key, field in (("set", "set_name"), ("trial", "trial"), ("order", "order"), ("role", "role")):
            columns[key] = [getattr(trial, field) for _, trial in rows]
        columns["judged"] = [trial.used for _, trial in rows]
        for when in ("before", "after"):
            for error in ("chamfer", "chamfer_floor", "surface_rms", "surface_floor"):
                columns[f"{error}_{when}"] = [in_mm(getattr(getattr(trial, when), error)) for _, trial in rows]
        judged = [trial.intervals for _, trial in rows]
        if any(judged):
            for k, name in enumerate(("interval_inside", "interval_width", "interval_crps")):
                columns[name] = [np.nan if score is None else score.shown[k] for score in judged]
        return columns


def _of_model(model: Model) -> Columns:
    rows = [(name, p.factor, "", p.interval90, p.scope) for name, p in model.parameters.items()]
    rows += [
        (f"{effect.name}.{name}", q.value, q.unit, q.interval90, effect.scope)
        for effect in model.effects
        for name, q in effect.parameters.items()
    ]
    low, high = ([np.nan if row[3] is None else row[3][k] for row in rows] for k in (0, 1))
    return {
        "name": [row[0] for row in rows],
        "value": [row[1] for row in rows],
        "unit": [row[2] for row in rows],
        "low90": low,
        "high90": high,
        "scope": [row[4] for row in rows],
    }


def _extra(error: ModuleNotFoundError) -> InputError:
    return InputError(needs(error))
