"""A trace in words."""

from collections.abc import Sequence

from fabdesign.effects import EFFECTS
from fabdesign.effects.learned import formula
from fabdesign.nouns.forward import Term
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.units import in_mm
from studies.model_selection.verdict import effect_in_words
from studies.report.page import gain_in_words
from studies.tracing.experiment import Explanation
from studies.tracing.outcome import Outcome


def verdict_in_words(outcome: Outcome) -> str:
    """Return the answer in a sentence."""
    evidence, left = outcome.evidence, in_mm(outcome.evidence.after)
    before = f"{in_mm(evidence.before):.2f} mm"
    if outcome.verdict == "adequate":
        return (
            f"Nothing is missing: with its declared parameters refitted, the model is {before} off over the noise on "
            f"held-out trials, within the tolerance of {in_mm(outcome.tolerance):g} mm."
        )
    if outcome.verdict == "unexplained":
        missing = "Something is missing that none of the known effects explains, alone or in combination:"
        if outcome.discovered is not None:
            without, with_it = in_mm(outcome.discovered.before), in_mm(outcome.discovered.excess)
            return (
                f"{missing} the excess over the noise is {without:.2f} mm on held-out trials, and "
                f"{with_it:.2f} mm with a formula that was found, which is in the model: "
                f"{formula(outcome.model.effects[-1].term.values)}."
            )
        sentence = (
            f"{missing} the excess over the noise is {before} on held-out trials and "
            f"{in_mm(evidence.fitted or 0.0):.2f} mm on fitted ones; a flexible baseline leaves "
            f"{in_mm(evidence.box_before):.2f} mm of it."
        )
        if evidence.typical <= outcome.tolerance:
            sentence += (
                f" Half of the trials leave no more than {in_mm(evidence.typical):.2f} mm each: what single trials do "
                "not have in common may be the experiment's (handling, heat), or another stable shape of the cloth."
            )
        return sentence
    named = " and ".join(_one_answer(effect, outcome.alike) for effect in outcome.effects)
    sentence = (
        f"Missing was {named}: on held-out trials the excess over the noise is {before} without and {left:.2f} mm "
        "with it"
    )
    if evidence.after > outcome.tolerance >= evidence.fitted_after:
        sentence += f", which leaves {in_mm(evidence.fitted_after):.2f} mm of the trials that it was fitted to"
    sentence += "."
    if outcome.alike:
        sentence += f" {_how_to_tell(outcome.alike)}"
    return sentence


def _one_answer(effect: EffectTerm, alike: Sequence[Explanation]) -> str:
    """Return an effect, with what does the same in the data as a part of the one answer."""
    others = {one.term.name: one.term for one in alike if one.instead_of == effect.name}
    return " or ".join([effect_in_words(effect), *(_term_in_words(term) for term in others.values())])


def _how_to_tell(alike: Sequence[Explanation]) -> str:
    """Say that effects are one answer, and by which measurements they would be two."""
    pairs = dict.fromkeys([*(one.instead_of for one in alike), *(one.term.name for one in alike)])
    measured = [EFFECTS[name].looks_like.partition("; ")[2] for name in pairs]
    how = "; or ".join(text for text in measured if text)
    sentence = 'These data cannot tell apart what stands on either side of an "or"'
    return f"{sentence}; to tell: {how}." if how else f"{sentence}."


def _term_in_words(term: Term) -> str:
    effect = EFFECTS[term.name]
    quantities = {name: Quantity(value, effect.parameters[name].unit) for name, value in term.values.items()}
    return effect_in_words(EffectTerm(term.name, quantities))


def experiment_in_words(outcome: Outcome) -> str | None:
    next_one = outcome.next_experiment
    if next_one is None:
        return None
    program, explanations = next_one["program"], " and ".join(next_one["separates"])
    return (
        f"{program['what']} ({program['duration_s']:g} s): there {explanations} "
        f"are {next_one['expected_gain']:.1f} mm RMS apart, beyond what the declared parameters could take."
    )


def as_text(outcome: Outcome) -> str:
    """Return a trace in words for the terminal."""
    result = outcome.as_json()
    error = result["error"]
    lines = [f"{outcome.verdict}: {verdict_in_words(outcome)}"]
    lines.append(
        f"surface RMS of held-out trials {error['before']['held_out']:.2f} -> {error['after']['held_out']:.2f} mm, "
        f"noise floor {error['noise_floor']:.2f}, flexible baseline {error['ceiling']:.2f}"
    )
    for row in result["candidates"]:
        if row["name"] != "none":
            what = "gains" if row["chosen"] else "would gain"
            lines.append(f"  {row['name']:<20} {what} {gain_in_words(row['gain'], row['interval90'], 'mm')}")
    lines.append(f"left out: {outcome.data.used.share_left_out:.0%} of the frames")
    lines += outcome.said
    if (experiment := experiment_in_words(outcome)) is not None:
        lines.append(f"next: {experiment}")
    return "\n".join(lines)
