"""The rules by which effects are dropped again, one by one, on selections whose gains are made up."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import pytest

from studies.model_selection import rules
from studies.model_selection.judged import Decoys
from studies.model_selection.rules import Refits, Selection, follow

LOWER_END = 0.9  # of a gain, its lower end: certain


@dataclass(frozen=True, eq=False)
class Known:
    """A fit whose trials left out gain so much [mm] by each effect, more or less on their own; a fit without one in
    `needed` predicts worse."""

    gain: dict[str, float]
    excess: float = 0.0
    needed: frozenset[str] = frozenset()
    strength: dict[str, float] = field(default_factory=dict)

    @property
    def fit(self):
        return SimpleNamespace(vector=SimpleNamespace(labels=(*self.gain,)), after=1.0, known=self)

    @property
    def parts(self):
        return {label: [0] for label in self.gain}

    @property
    def gains(self):
        return self.gains_without(())

    def gains_without(self, dropped, asked=None):
        return {k: (g, (LOWER_END * g, g)) for k, g in self.gain.items() if asked is None or k in asked}

    def predicts_better(self, other, least):
        return bool(self.needed - other.gain.keys())


class Made(Refits):
    """Fits with fewer effects are the same with fewer gains."""

    tolerance = 0.5

    def __init__(self, chance=0.0):
        self.calls, self.chance = [], chance

    def judged(self, fit):
        return fit.known

    def without(self, known, labels):
        self.calls.append(("without", *labels))
        return replace(known.known, gain={k: g for k, g in known.known.gain.items() if k not in labels}).fit

    def alone(self, known, plain):
        self.calls.append(("alone",))
        return Known({}, 9.0).fit

    def decoys(self, known, everything):
        self.calls.append(("decoys",))
        return Decoys(((self.chance, (0.0, 1.0)),), (True,))


@pytest.fixture(autouse=True)
def causes(monkeypatch):
    """Of an effect without a strength of its own, ten times what is usual."""
    monkeypatch.setattr(rules, "strength", lambda fit, label: fit.known.strength.get(label, 10.0))
    monkeypatch.setattr(rules, "is_cause", lambda fit, label: fit.known.strength.get(label, 10.0) >= rules.CAUSE)


def selection(gain, **known):
    judged = Known(gain, **known)
    return Selection(judged.fit, Known({}), judged, of_all=judged.excess)


def test_what_gains_less_than_the_tolerance_goes_and_of_several_less_than_what_is_left():
    made = Made()
    after = rules.too_little(made, selection({"lag": 3.0, "droop": 0.4, "creep": 0.6}))
    assert after.small == ("droop",) and [*after.gains] == ["lag", "creep"]
    after = rules.too_little(made, selection({"lag": 3.0, "creep": 0.6}, excess=0.7))
    assert after.small == ("creep",)
    last = rules.too_little(made, selection({"creep": 0.4}))
    assert last.chosen.vector.labels == () and last.small == ("creep",)
    assert rules.too_little(made, selection({"creep": 0.6}, excess=0.7)) is None  # alone, the tolerance counts


def test_what_a_fit_without_it_loses_is_not_dropped_nor_asked_again():
    made, begun = Made(), selection({"lag": 3.0, "droop": 0.4}, needed=frozenset(["droop"]))
    after = rules.too_little(made, begun)
    assert after.asked == ("droop",) and [*after.gains] == ["lag", "droop"]
    assert rules.too_little(made, after) is None


def test_the_least_of_several_is_asked_though_it_gains_enough_to_first_order():
    gains = {"lag": 3.0, "droop": 2.0, "creep": 1.0}
    after = rules.too_little(Made(), selection(gains))
    assert after.small == ("creep",) and [*after.gains] == ["lag", "droop"]
    after = rules.too_little(made := Made(), selection(gains, needed=frozenset(["creep"])))
    assert after.asked == ("creep",) and [*after.gains] == [*gains]
    assert rules.too_little(made, after) is None and made.calls == [("without", "creep")]


def test_the_declared_parameters_begin_beside_the_last_effect_once():
    after = rules.begin_beside(made := Made(), selection({"lag": 3.0}))
    assert after.beside and after.plain.known.excess == 9.0 and made.calls == [("alone",)]
    assert rules.begin_beside(made, after) is None
    assert rules.begin_beside(made, selection({"lag": 3.0, "droop": 2.0})) is None


@pytest.mark.parametrize(("chance", "asked"), [(0.4, ("lag",)), (0.6, ())])
def test_what_one_decoy_in_twenty_gains_is_asked_of_effects_too(chance, asked):
    begun = replace(selection({"lag": 3.0, "droop": 0.55}), asked=("lag",))
    after = rules.by_chance(made := Made(chance), begun)
    assert after.asked == asked and rules.by_chance(made, after) is None
    assert rules.least(made, after) == max(chance, 0.5)


def test_what_is_next_to_nothing_is_no_cause():
    slight = {"lag": 0.2, "droop": 0.1}
    after = rules.no_cause(Made(), selection({"lag": 3.0, "droop": 2.0}, strength=slight))
    assert after.small == ("droop",) and [*after.gains] == ["lag"]
    after = rules.no_cause(Made(), selection({"lag": 3.0}, strength=slight))
    assert after.chosen.vector.labels == () and after.small == ("lag",)
    assert rules.no_cause(Made(), selection({"lag": 3.0, "droop": 2.0}, strength={"droop": 0.1})) is None


def test_rules_are_followed_in_order_until_none_applies():
    """And a new one is a function and a line."""
    named = []

    def one_at_most(refits, begun):
        """Keep the effect that gains most."""
        named.append([*begun.gains])
        weak = sorted(begun.gains, key=lambda label: begun.gains[label][0])[:-1]
        return begun.without(refits.judged(refits.without(begun.chosen, weak)), weak) if weak else None

    begun = selection({"lag": 3.0, "droop": 2.0, "creep": 0.1}, needed=frozenset(["lag", "droop"]))
    ours = rules.Rule("one at most", "one effect", "a wish", one_at_most)
    after = follow((*rules.ON_SETS, ours), Made(), begun)
    assert [*after.gains] == ["lag"] and set(after.small) == {"droop", "creep"}
    assert all("creep" not in gains for gains in named)  # which an earlier rule had dropped
    assert after.decoys is not None
    for rule in rules.ON_SETS:
        assert rule.name and rule.threshold and rule.origin and rule.step.__doc__
