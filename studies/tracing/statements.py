"""A trace in words."""

from fabdesign.effects.learned import formula
from fabdesign.nouns.model import EffectTerm, Quantity
from fabdesign.units import in_mm
from studies.report.page import gain_in_words
from studies.tracing.outcome import Outcome


def verdict_in_words(outcome: Outcome) -> str:
    """The answer in a sentence."""
    evidence, left = outcome.evidence, in_mm(outcome.evidence.after)
    before = f"{in_mm(evidence.before):.2f} mm"
    if outcome.verdict == "adequate":
        return (
            f"The model with its declared parameters refitted is adequate: on held-out trials its excess over the "
            f"noise is {before}, within the tolerance of {in_mm(outcome.tolerance):g} mm."
        )
    if outcome.verdict == "unexplained":
        missing = "Something is missing that none of the known effects explains, alone or in combination:"
        if outcome.discovered is not None:
            found = outcome.discovered
            return (
                f"{missing} the excess over the noise is {in_mm(found.before):.2f} mm on held-out trials, and "
                f"{in_mm(found.excess):.2f} mm with a formula that was found, which is in the model: "
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
    named = " and ".join(effect_in_words(effect) for effect in outcome.effects)
    sentence = (
        f"Missing was {named}: on held-out trials the excess over the noise is {before} without and {left:.2f} mm "
        "with it"
    )
    if evidence.after > outcome.tolerance >= evidence.fitted_after:
        sentence += f", which leaves {in_mm(evidence.fitted_after):.2f} mm of the trials that it was fitted to"
    sentence += "."
    if outcome.indistinguishable:
        sentence += f" These data cannot distinguish it from {', '.join(outcome.indistinguishable)}."
    return sentence


def effect_in_words(effect: EffectTerm) -> str:
    values = ", ".join(f"{name.replace('_', ' ')} {_value(q)}" for name, q in effect.parameters.items())
    return f"{effect.name.replace('_', ' ')} ({values})"


def _value(quantity: Quantity) -> str:
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    if quantity.interval90 is None:
        return f"{quantity.value:.3g}{unit}"
    return f"{quantity.value:.3g}{unit}, 90 % {quantity.interval90[0]:.3g} to {quantity.interval90[1]:.3g}"


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
    """For the terminal."""
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
