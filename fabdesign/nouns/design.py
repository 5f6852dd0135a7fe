"""A design: one cloth with its muscles, and the effects that its benches found."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from fabdesign.formats.result_tables import design_summary
from fabdesign.formats.schema import Key
from fabdesign.nouns.fabric import Fabric
from fabdesign.nouns.muscle import Muscle, MuscleType

MUSCLE_TYPES = "muscle_types."  # begins a scope, or the name of a factor, that is one muscle type's


@dataclass(frozen=True)
class Term:
    """An effect that acts: its name in fabdesign.effects.EFFECTS and its parameters' values, in their declared units.

    scope: what it belongs to, such as "muscle_types.em20": then it acts on the muscles of that type alone.
    """

    name: str
    values: Mapping[str, float] = field(default_factory=dict)  # what is absent has the declaration's typical value
    scope: str | None = None


_MAY_LACK = Key(absent=lambda table: ())  # in a file: others that it includes may have it


@dataclass(frozen=True)
class Design:
    """A cloth, the muscle types laced into it by name, and the muscles with their paths: SI units throughout.

    Holds what is given: files.design_file.read_design checks a file (paths within the cloth, types known, at most
    256 muscles), fabdesign.nouns.catalogue.build makes the paper's layouts.

    >>> from fabdesign.nouns.catalogue import build
    >>> design = build("cross", muscles=2)
    >>> design.channels, design.muscles[0].side, design.fabric.width  # width in m
    (2, 'front', 0.2)
    """

    name: Annotated[str, Key(absent=lambda table: table.file.stem), "by default the file's"]
    fabric: Annotated[Fabric, _MAY_LACK, "the cloth"]
    muscle_types: Annotated[Mapping[str, MuscleType], _MAY_LACK, "by the names in a muscle's type"]
    muscles: Annotated[tuple[Muscle, ...], _MAY_LACK, "absent: the design takes no pressures"]
    effects: Annotated[tuple[Term, ...], Key("")] = ()  # found on the benches of its muscle types and its cloth

    @property
    def channels(self) -> int:
        """Return the number of pressure channels: the highest channel in use, plus one."""
        return max((m.channel for m in self.muscles), default=-1) + 1

    def __str__(self) -> str:
        return design_summary(self).text()

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return design_summary(self).html()
