"""Results that no study has of its own: sweeps, and predictions of what is not sewn as a table."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.formats.result_tables import Columns, Tabled, by_name
from fabdesign.nouns.design import Design


@dataclass(frozen=True, eq=False)
class Sweep(Tabled):
    """Numbers of many shapes. pressures: of each design, (channels,) kPa at the end. values: (n,) of each output.
    complete: False where it was interrupted."""

    designs: tuple[Design, ...]
    pressures: tuple[NDArray[np.float64], ...]
    values: Mapping[str, NDArray[np.float64]]
    complete: bool

    def __getitem__(self, output: str) -> NDArray[np.float64]:
        """Return (n,) of an output."""
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


class Unseen(dict[str, Any], Tabled):
    """The content of `result.json` of a study of kind `unseen` holds."""

    __str__, __repr__ = Tabled.__str__, dict.__repr__

    def as_json(self) -> dict[str, Any]:
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
