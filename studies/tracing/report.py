"""A trace in words, and the page that says what it found: self-contained, for any browser, without a network."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from markupsafe import Markup

from fabdesign.effects import EFFECTS
from fabdesign.effects.learned import formula
from fabdesign.files.motion_file import square_triangles
from fabdesign.nouns.forward import Term
from fabdesign.nouns.model import EffectTerm, Parameter, Quantity
from fabdesign.units import in_mm
from studies.measured.used_frames import WHY
from studies.model_selection.black_box import Residuals
from studies.model_selection.verdict import effect_in_words
from studies.report import charts, page
from studies.report.page import gain_in_words
from studies.tracing.experiment import Explanation
from studies.tracing.outcome import Outcome, effects_in_words
from studies.tracing.residual_analysis import remains
from studies.view import Item, render_page


def verdict_in_words(outcome: Outcome) -> str:
    """Return the answer in a sentence."""
    evidence, excess = outcome.evidence, in_mm(outcome.evidence.after)
    before = f"{in_mm(evidence.before):.2f} mm"
    if outcome.verdict == "adequate":
        return (
            f"Nothing is missing: with its declared parameters refitted, the model is {before} off over the noise on "
            f"held-out trials, within the tolerance of {in_mm(outcome.tolerance):g} mm."
        )
    if outcome.verdict == "unexplained":
        missing = "Something is missing that none of the known effects explains, alone or in combination:"
        if outcome.discovered is not None:
            without, with_it = in_mm(evidence.before), in_mm(outcome.discovered.excess)
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
            sentence += _of_single_trials(evidence.typical)
        if outcome.selection.labels:
            part = effects_in_words(outcome.selection.labels, " and ")
            sentence += f" A part would be taken by {part}, which leaves {excess:.2f} mm."
        return sentence
    named = " and ".join(_one_answer(effect, outcome.alike) for effect in outcome.effects)
    sentence = (
        f"Missing was {named}: on held-out trials the excess over the noise is {before} without and {excess:.2f} mm "
        "with it."
    )
    if evidence.after > outcome.tolerance >= evidence.typical_after:
        sentence += _of_single_trials(evidence.typical_after)
    if outcome.alike:
        sentence += f" {_how_to_tell(outcome.alike)}"
    return sentence


def _of_single_trials(typical: float) -> str:
    """Return a sentence on what is left of single trials. typical: m, the median of trials."""
    return (
        f" Half of the trials leave no more than {in_mm(typical):.2f} mm each: what single trials do not have in "
        "common may be the experiment's (handling, heat), or another stable shape of the cloth."
    )


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
    floor, ceiling, after, before = outcome.compared
    lines = [f"{outcome.verdict}: {verdict_in_words(outcome)}"]
    lines.append(
        f"surface RMS of held-out trials {before:.2f} -> {after:.2f} mm, noise floor {floor:.2f}, flexible baseline "
        f"{ceiling:.2f}"
    )
    for row in outcome.rows[1:]:
        what = "gains" if row.chosen else "would gain"
        lines.append(f"  {row.name:<20} {what} {gain_in_words(row.gain, row.interval90, 'mm')}")
    lines.append(f"left out: {outcome.data.used.share_left_out:.0%} of the frames")
    lines += outcome.sentences
    if (experiment := experiment_in_words(outcome)) is not None:
        lines.append(f"next: {experiment}")
    return "\n".join(lines)


_FRAMES = 45  # of the motion shown
_ERROR = """Surface RMS: distance of every measured point to the model's faces, capped at 10 mm, in the frames used of
trials held out ({}). Before: declared parameters refitted. Baseline: what a flexible, non-parametric regression without
physics leaves."""
_GAIN = """All effects are fitted together with the declared parameters, then those dropped that the data do not need.
Gain: of an effect in the model, the excess of trials held out that its absence costs; of another, what it would take
beside the model; "none": it would take nothing. Excess is the error less the noise, in quadrature. To first order about
the fit."""


def render_report(outcome: Outcome) -> str:
    """Return HTML."""
    return page.html_of(f"{outcome.name}: {outcome.verdict}", [*_answer(outcome), *_residual(outcome), *_data(outcome)])


def _answer(outcome: Outcome) -> Iterator[page.Block]:
    """Yield the verdict, how far the model is off, and what each effect would take."""
    yield page.Title(f"{outcome.name}: what the model lacks", 1)
    verdict = page.sentence(verdict_in_words(outcome))
    yield page.Text(Markup("<b>{}.</b> {}").format(outcome.verdict.capitalize(), verdict), "verdict")
    rig = "an independent simulation with a model of a sensor, not hardware."
    if outcome.synthetic:
        yield page.Text(Markup("Measured on a <b>synthetic rig</b>: {}").format(rig), "note")
    yield from page.texts("note", map(page.sentence, outcome.sentences))
    yield charts.error_bars(outcome.compared, "noise floor", "mm", "surface RMS of trials held out")
    tested = any(error.role == "test" for error in outcome.errors)
    held_out = "those of role test, looked at once" if tested else "each trial left out in turn, to first order"
    yield page.Text(_ERROR.format(held_out), "quiet")
    for effect in outcome.effects:
        yield page.Text(Markup("<b>{}</b>: {}.").format(effect.name, EFFECTS[effect.name].signature))
    yield page.Title("Candidates")
    gains = [(c.name, c.gain, c.interval90, c.chosen) for c in outcome.candidates]
    yield charts.gains("candidates", gains, "mm", "gain of held-out excess", outcome.tolerance, scale=in_mm(1.0))
    rows = [
        (
            row.name,
            "yes" if row.chosen else "",
            page.gain_in_words(row.gain, row.interval90, ""),
            _detectable(row.name, outcome.detectable.get(row.name, {})),
        )
        for row in outcome.rows[1:]
    ]
    yield page.TableBlock(
        ("effect", "in the model", "gain\nmm", "smallest value\nthat would have shown"), rows, left_aligned=(3,)
    )
    yield page.Text(_GAIN, "quiet")


def _detectable(effect: str, values: Mapping[str, float]) -> str:
    shown = [(name.replace("_", " "), value, EFFECTS[effect].parameters[name].unit) for name, value in values.items()]
    return "; ".join(f"{name} {value:.3g} {'' if unit == '1' else unit}" for name, value, unit in shown)


def _residual(outcome: Outcome) -> Iterator[page.Block]:
    """Yield where on the cloth and when something is left, as a motion too, and what to measure next."""
    after = outcome.remains
    before = remains(Residuals.of(outcome.data, outcome.before), outcome.selection.folds)
    most = float(np.nanmax([before.cells, after.cells]))  # alike before and after so that they compare
    fabric, stages = outcome.data.trials[0].design.fabric, {"before": before, "after": after}
    size = fabric.width, fabric.height
    yield page.Title("The residual on the cloth and over time")
    maps = {which: charts.cloth(f"cloth-{which}", which, of.cells, size, most) for which, of in stages.items()}
    yield page.Columns([[maps["before"]], [maps["after"]]])
    curves = []
    for (which, of), colour in zip(stages.items(), (charts.RED, charts.BLUE), strict=True):
        for k, (name, (times, rms)) in enumerate(of.over_time.items()):
            hover = f"{name} {which}: %{{y:.2f}} mm at %{{x:.2f}} s<extra></extra>"
            group = {"legendgroup": which, "showlegend": k == 0, "hovertemplate": hover, "line_width": 1}
            curves.append(charts.curve(which, times, in_mm(rms), colour, **group))
    yield charts.chart("time", curves, x="time, s", y="RMS, mm", yaxis={"rangemode": "tozero"})
    u, v = (page.mm(place, 0) for place in after.where)
    follows = f"; it goes with {outcome.follows}" if outcome.follows else ""
    when = f"about {after.when:.1f} s after rest{follows}"
    yield page.Text(f"What is left is largest at u, v = {u}, {v} mm, {when}.")
    yield page.Title(f"Trial {_worst(outcome)}: measured, before, after")
    yield page.MotionBlock(_motion(outcome))
    yield page.Title("What to measure next")
    yield page.Text(experiment_in_words(outcome) or "No program within the limits would tell more.")
    if outcome.next_experiment is not None:
        program = outcome.next_experiment["program"]
        instants, rows = [*program["time_s"], program["duration_s"]], program["pressure_kpa"]
        channels = enumerate(zip(*rows, rows[-1], strict=True))
        steps = [charts.curve(f"channel {c}", instants, values, line_shape="hv") for c, values in channels]
        yield charts.chart("program", steps, x="time, s", y="pressure, kPa")


def _data(outcome: Outcome) -> Iterator[page.Block]:
    """Yield the errors of each trial, what was left out, and the factors."""
    used, model = outcome.data.used, outcome.model
    yield page.Title("Errors by trial")
    rows = [
        (e.trial, e.role, *map(in_mm, (e.before.surface_rms, e.after.surface_rms, e.after.surface_floor)))
        for e in outcome.errors
    ]
    yield page.TableBlock(("trial", "role", "before\nmm", "after\nmm", "noise floor\nmm"), rows)
    yield page.Title("Frames left out")
    why = f": {WHY}" if used.stretches else ""
    yield page.Text(f"{100 * used.share_left_out:.0f} % of the frames are left out{why}.")
    if used.stretches:
        yield page.TableBlock(("trial", "from, s", "to, s"), [(s.trial, s.begin, s.end) for s in used.stretches])
    yield page.Title("Factors on the declared values, with 90 % intervals")
    plain = model.without_effects or model.parameters
    factors = [(name, _factor(plain[name]), _factor(parameter)) for name, parameter in model.parameters.items()]
    yield page.TableBlock(("parameter", "without effects", "in the model"), factors)


def _factor(parameter: Parameter) -> str:
    ends = parameter.interval90
    known = f" ({page.interval(ends)})" if ends is not None and np.isfinite(ends).all() else ""
    return f"{parameter.factor:.3f}{known}"


def _worst(outcome: Outcome) -> str:
    """Return the trial of role fit whose error was largest before."""
    errors = [e for e in outcome.errors if e.role == "fit" and np.isfinite(e.before.surface_rms)]
    return max(errors, key=lambda e: e.before.surface_rms).trial


def _motion(outcome: Outcome) -> str:
    name = _worst(outcome)
    trial = next(trial for trial in outcome.data.trials if trial.name == name)
    frames = np.unique(np.linspace(0, len(trial.times) - 1, min(_FRAMES, len(trial.times))).round().astype(int))
    times, clouds = trial.times[frames], trial.load().frames
    cases = [fit.vector.case(trial, fit.x) for fit in (outcome.before, outcome.after)]
    motions = outcome.forward.motions(cases, [times, times])
    items = [Item(f"measured, {name}", times, [clouds[int(k)] for k in frames])]
    for title, motion in zip(("before", "after"), motions, strict=True):
        if np.isfinite(motion).all():
            items.append(Item(title, times, motion, square_triangles(motion.shape[1])))
    return render_page(f"{outcome.name}/{name}", items)
