"""What terms are called where several of one effect act: by what was chosen of each, such as a channel or a place."""

from collections.abc import Sequence

from fabdesign.effects.registry import EFFECTS
from fabdesign.term import Term


def labels_of(terms: Sequence[Term]) -> tuple[str, ...]:
    """Of each term: its effect's name; of several of one effect "NAME:VALUE,..." by its chosen parameters."""
    names = [term.name for term in terms]
    return tuple(term.name if names.count(term.name) == 1 else f"{term.name}:{_chosen(term)}" for term in terms)


def _chosen(term: Term) -> str:
    effect = EFFECTS[term.name]
    return ",".join(f"{effect.values(term.values)[name]:g}" for name in effect.chosen)
