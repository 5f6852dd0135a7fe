"""A joint fit of some effects of the list: each strength costs a motion of every trial."""

import pytest

from fabdesign.effects.registry import EFFECTS


def restrict_effects(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """That "all" means these."""
    monkeypatch.setattr(
        "optimize.fit.free_parameters.EFFECTS", {name: EFFECTS[name] for name in (*names, "discovered")}
    )
