"""Study files of kind "layouts": a search for every number of muscles, type and choice of sides."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from fabdesign.design import Design
from fabdesign.effort import MUSCLES
from fabdesign.errors import InputError
from fabdesign.model import Model
from fabdesign.study_file import FORMAT, MuscleChoice, Side, Study, read_subject, require_kind, search_of
from fabdesign.table import Table, load_toml, nearest

Sides = Literal["front", "back", "both"]
SIDES: dict[str, tuple[Side, ...]] = {"front": ("front",), "back": ("back",), "both": ("front", "back")}


@dataclass(frozen=True, eq=False)
class Cell:
    """One search of the grid. name: of its folder."""

    name: str
    muscles: int
    type: str
    sides: Sides
    study: Study

    def includes(self, other: "Cell") -> bool:
        """Whether what `other` may lay out this cell may too, with muscles left over."""
        fewer = other.type == self.type and other.muscles <= self.muscles
        return fewer and {*SIDES[other.sides]} <= {*SIDES[self.sides]}


@dataclass(frozen=True, eq=False)
class LayoutsStudy:
    """search: what all cells have in common. Each cell may use an even share of its limits' evaluations; their seconds
    are an even share too, which `studies.layout_grid` moves to where they gain."""

    search: Study
    muscles: tuple[int, ...]
    types: tuple[str, ...]
    sides: tuple[Sides, ...]

    @property
    def cells(self) -> Iterator[Cell]:
        """Each after all that it includes."""
        count = len(self.muscles) * len(self.types) * len(self.sides)
        limits = self.search.limits
        limits = replace(limits, seconds=limits.seconds / count, evaluations=max(1, limits.evaluations // count))
        for type_ in self.types:
            for muscles in self.muscles:
                for sides in sorted(self.sides, key=lambda sides: len(SIDES[sides])):
                    name = f"{muscles}_{type_}_{sides}"
                    own = replace(_of_type(self.search, type_), name=name, limits=limits)
                    study = replace(own, muscles=MuscleChoice(muscles, muscles, SIDES[sides]))
                    yield Cell(name, muscles, type_, sides, study)


def _of_type(search: Study, type_: str) -> Study:
    """The search with one muscle type; the design's muscles begin it where all are of that type."""
    design = search.design
    alike = all(muscle.type == type_ for muscle in design.muscles)
    design = replace(
        design,
        muscle_types={type_: design.muscle_types[type_]},
        muscles=design.muscles if alike else (),
    )
    return replace(search, design=design, start_pressures=search.start_pressures if alike else None)


def read_layouts(path: Path | str) -> LayoutsStudy:
    """Read a study of kind "layouts". Keys: docs/files.md. Raises InputError."""
    path = Path(path)
    root = load_toml(path, FORMAT, partial=True)
    require_kind(root, "layouts")
    return layouts_of(root, path, *read_subject(root, path))


def layouts_of(root: Table, path: Path, design: Design, model: Model | None) -> LayoutsStudy:
    """A study from the table of its file at `path`, whose other keys have been taken. Raises InputError."""
    grid = root.table("grid")
    variables = root.table("variables", None) or Table({}, "")
    if "muscles" in variables or "start" in root:
        raise InputError(f"{path}: muscles of [variables] and start belong to one search; expected a [grid] alone")
    search = search_of(root, path, design, model)
    if "positions" not in variables:
        search = replace(search, positions=True)
    if not search.pressures:
        raise InputError(f"{path}: variables: pressures = false; expected true where muscles are laid out")
    counts = grid.take("muscles")
    if not isinstance(counts, list) or not counts or not all(_is_count(n) for n in counts):
        raise grid.bad("muscles", f"numbers of muscles from 1 to {MUSCLES}, such as [1, 2, 4]")
    known = tuple(search.design.muscle_types)
    types = grid.texts("types", known)
    for name in types:
        if name not in known:
            raise InputError(f"{grid.where}: no muscle type {name}; expected {', '.join(known)}{nearest(name, known)}")
    sides = grid.texts("sides", tuple(SIDES))
    if not types or not sides or not {*sides} <= {*SIDES}:
        raise grid.bad("sides" if types else "types", 'some of "front", "back", "both"' if types else "a type or more")
    grid.finish()
    return LayoutsStudy(search, *(tuple(dict.fromkeys(values)) for values in (sorted(counts), types, sides)))


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MUSCLES
