"""Force laws of a strip of cloth: tension per width over engineering strain."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MembraneCurve:
    """Sampled tension per width [N/m] over engineering strain, for direction 1 (across), 2 (down) or both."""

    strain: tuple[tuple[float, ...], tuple[float, ...]]  # per direction, rising; empty: the linear stiffness holds
    tension: tuple[tuple[float, ...], tuple[float, ...]]  # N/m
