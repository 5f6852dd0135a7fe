"""Study files of kind "layouts": a search for every number of muscles, type and choice of sides."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from fabdesign.formats.schema import Key, Within
from fabdesign.formats.table import Table, nearest
from fabdesign.runtime.effort import MUSCLES
from fabdesign.study_files.study_file import MuscleChoice, Side, Study, StudyFile

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
        """Return whether what `other` may lay out this cell may too, with muscles left over."""
        fewer = other.type == self.type and other.muscles <= self.muscles
        return fewer and {*SIDES[other.sides]} <= {*SIDES[self.sides]}


_EXPECTED = f"numbers of muscles from 1 to {MUSCLES}, such as [1, 2, 4], and none in [variables]"
_Counts = Annotated[tuple[int, ...], Within(least=1, most=MUSCLES), Key(expected=_EXPECTED)]
_COUNTS = Key("grid.muscles", form=_Counts, read=lambda value, _: tuple(sorted({*value})) or None, expected=_EXPECTED)
_TYPES = Key("grid.types", absent=lambda table: tuple(table.decoded["search"].design.muscle_types))
_SIDES = Key("grid.sides", expected='some of "front", "back", "both"')


@dataclass(frozen=True, eq=False)
class LayoutsStudy(StudyFile):
    """search: what all cells have in common. Each cell may use an even share of its limits' evaluations; their seconds
    are an even share too, which `studies.layout_grid` moves to where they gain."""

    kind = "layouts"
    search: Annotated[Study, Key(inside=True)]
    muscles: Annotated[tuple[int, ...], _COUNTS, "a search for each number"]
    types: Annotated[tuple[str, ...], _TYPES, "muscle types; absent: each of the design"]
    sides: Annotated[tuple[Sides, ...], _SIDES, "absent: these three"] = ("front", "back", "both")

    def resolved(self, table: Table) -> "LayoutsStudy":
        """Return the grid without repetitions. Raises InputError for keys of one search, and for unknown types."""
        variables, grid = table.within(["variables"]), table.within(["grid"])
        if "muscles" in variables or "start" in table:
            raise table.error("muscles of [variables] and start belong to one search; expected a [grid] alone")
        search = self.search if "positions" in variables else replace(self.search, positions=True)
        if not search.pressures:
            raise variables.error("pressures = false; expected true where muscles are laid out")
        known = tuple(search.design.muscle_types)
        for name in self.types:
            if name not in known:
                raise grid.error(f"no muscle type {name}; expected {', '.join(known)}{nearest(name, known)}")
        if not self.types or not self.sides:
            raise grid.bad("sides" if self.types else "types", "some of them")
        types, sides = tuple(dict.fromkeys(self.types)), tuple(dict.fromkeys(self.sides))
        return LayoutsStudy(search, self.muscles, types, sides)

    @property
    def cells(self) -> Iterator[Cell]:
        """Yield the cells, each after all that it includes."""
        count = len(self.muscles) * len(self.types) * len(self.sides)
        limits = self.search.limits
        limits = replace(limits, seconds=limits.seconds / count, evaluations=max(1, limits.evaluations // count))
        design = self.search.design
        for type_ in self.types:
            alike = all(muscle.type == type_ for muscle in design.muscles)  # else they do not begin it
            types, laced = {type_: design.muscle_types[type_]}, design.muscles if alike else ()
            search = replace(
                self.search,
                design=replace(design, muscle_types=types, muscles=laced),
                start_pressures=self.search.start_pressures if alike else None,
                limits=limits,
            )
            for muscles in self.muscles:
                for sides in sorted(self.sides, key=lambda sides: len(SIDES[sides])):
                    name = f"{muscles}_{type_}_{sides}"
                    study = replace(search, name=name, muscles=MuscleChoice(muscles, muscles, SIDES[sides]))
                    yield Cell(name, muscles, type_, sides, study)
