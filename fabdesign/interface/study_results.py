"""Results of searches and studies: arrays, and the same as tables where the extra `tables` is there."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.errors import InputError
from fabdesign.interface.results import Columns, Motion, Tabled
from fabdesign.pressure import poses_in_words
from fabdesign.summary import Summary, muscle_columns
from fabdesign.units import in_kpa, in_mm

if TYPE_CHECKING:
    from studies.layout_grid.result import GridResult
    from studies.layouts.result import StudyResult
    from studies.sensitivity.result import SensitivityResult


@dataclass(frozen=True, eq=False)
class Optimized(Tabled):
    """found: all that the search says."""

    found: "StudyResult"

    def summary(self) -> Summary:
        """Return error, pressures, muscles and the layout."""
        from fabdesign.layout_drawing import layout_svg

        said = f"Optimized: {in_mm(self.objective):.3f} mm after {len(self.found.history)} evaluations"
        ended = f"{self.found.search_time}; {self.found.stop_reason}"
        lines = [said, ended, *self.found.reach.sentences, *poses_in_words(list(self.found.pressures))]
        highest = self.found.study.limits.pressure[1]
        pictures = [layout_svg(self.design, pressures, highest) for pressures in self.found.pressures]
        return Summary(lines, muscle_columns(self.design), pictures)

    @property
    def design(self) -> Design:
        return self.found.design

    @property
    def pressures(self) -> NDArray[np.float64]:
        """(poses, channels) kPa."""
        return in_kpa(self.found.pressures)

    @property
    def shapes(self) -> list[Motion]:
        """Of each pose, at rest or at its target's instant."""
        points = np.asarray(self.found.points, np.float32)
        return [Motion(np.array([t.time or 0.0]), p[None]) for t, p in zip(self.found.targets, points, strict=True)]

    @property
    def objective(self) -> float:
        """m, of the measure that was searched."""
        return self.found.objective

    def columns(self) -> Columns:
        """A row an evaluation of the search: its number, objective [mm], whether it diverged."""
        history = self.found.history
        return {
            "evaluation": [*range(1, len(history) + 1)],
            "objective_mm": [in_mm(entry.objective) for entry in history],
            "diverged": [entry.diverged for entry in history],
        }


@dataclass(frozen=True, eq=False)
class Sensitivity(Tabled):
    """found: all that the sweep says, its samples with them."""

    found: "SensitivityResult"

    @property
    def complete(self) -> bool:
        """False where the time ended, or it was interrupted."""
        return self.found.complete

    def indices(self, output: str) -> dict[str, dict[str, Any]]:
        """Of an output, by parameter: first, total and their intervals. Raises InputError where there are none."""
        entry = self.found.as_json()["outputs"].get(output)
        if entry is None or "sobol" not in entry:
            known = ", ".join(column.name for column in self.found.columns)
            raise InputError(f"{output}: no indices; expected an output that varies, of {known}")
        indices: dict[str, dict[str, Any]] = entry["sobol"]
        return indices

    def columns(self) -> Columns:
        """A row an output and parameter: method, and each of its numbers."""
        rows = [
            {"output": output, "unit": entry["unit"], "parameter": name, "method": method} | _flat(numbers)
            for output, entry in self.found.as_json()["outputs"].items()
            for method in ("morris", "sobol")
            for name, numbers in entry.get(method, {}).items()
        ]
        return _by_name(rows)


@dataclass(frozen=True, eq=False)
class Layouts(Tabled):
    """found: all that the searches of a grid say."""

    found: "GridResult"

    @property
    def front(self) -> list[Optimized]:
        """Of the cells that no other beats with as many muscles or fewer, by rising number of muscles."""
        return [Optimized(cell.result) for cell in self.found.front if cell.result is not None]

    def columns(self) -> Columns:
        """A row a cell: name, muscles, type, sides, the errors [mm] of the nearest layout that it may have, of which
        cell that is, muscles_used, front; and the study's outputs, a column for each pose."""
        rows = []
        for cell in self.found.as_json()["cells"]:
            poses = {
                name if len(output["values"]) == 1 else f"{name}, pose {pose}": value
                for name, output in cell.get("outputs", {}).items()
                for pose, value in enumerate(output["values"])
            }
            rows.append({name: value for name, value in cell.items() if not isinstance(value, list | dict)} | poses)
        return _by_name(rows)


@dataclass(frozen=True, eq=False)
class Unseen(Tabled):
    """found: what `result.json` of the study holds."""

    found: Mapping[str, Any]

    def columns(self) -> Columns:
        """A row a pose and output: pose, output, unit, and its 5, 50 and 95 % over the drawn models."""
        rows: list[dict[str, Any]] = []
        for number, pose in enumerate(self.found.get("poses") or []):
            own = [(f"tip_{axis}", "mm", values) for axis, values in pose["tip_mm"].items()]
            own.append(("mean_curvature", "1/m", pose["mean_curvature"]))
            own += [(name, output["unit"], output["percentiles"]) for name, output in pose["outputs"].items()]
            rows += [
                {"pose": number, "output": name, "unit": unit, "low90": low, "middle": middle, "high90": high}
                for name, unit, (low, middle, high) in own
            ]
        return _by_name(rows)


def _by_name(rows: Sequence[Mapping[str, Any]]) -> Columns:
    """Columns of rows that may lack some."""
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
