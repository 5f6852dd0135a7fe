"""An effect that acts, with its values."""

from collections.abc import Mapping
from dataclasses import dataclass, field

MUSCLE_TYPES = "muscle_types."  # begins a scope, or the name of a factor, that is one muscle type's


@dataclass(frozen=True)
class Term:
    """An effect that acts: its name in fabdesign.effects.EFFECTS and its parameters' values, in their declared units.

    scope: what it belongs to, such as "muscle_types.em20": then it acts on the muscles of that type alone.
    """

    name: str
    values: Mapping[str, float] = field(default_factory=dict)  # what is absent has the declaration's typical value
    scope: str | None = None
