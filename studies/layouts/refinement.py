"""The refinement after a search: no more muscles than needed, and a robust layout where it is asked for."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from fabdesign.study_files.study_file import Study
from fabdesign.study_files.study_targets import Price
from fabdesign.units import in_mm
from optimize.search.evaluations import Evaluations
from optimize.search.search_state import as_row, of_row
from optimize.search.starts import Start
from optimize.search.thinning import Fewer, fewer_muscles
from studies.layouts.robust_search import more_robust
from studies.layouts.robustness import most_robust, tolerance_of
from studies.layouts.scatter import Scattering

SHRINKING = 0.2  # of the seconds, kept for leaving muscles out where the study lets their number vary

ROBUST = 0.3  # and for a robust layout, where the study asks for one
POOL = 8  # layouts that such a choice is made among, at most
ROBUST_MARGIN = 0.1  # of the nearest value: so near they lie


def search_seconds(study: Study) -> float:
    """Return the seconds for the search itself."""
    kept = (SHRINKING if _may_shrink(study) else 0.0) + (ROBUST if study.robust else 0.0)
    return study.limits.seconds * (1 - kept)


def _may_shrink(study: Study) -> bool:
    choice = study.muscles
    return choice is not None and (choice.least < choice.most or study.price.channel > 0)


def shrunk(study: Study, evaluations: Evaluations) -> Fewer | None:
    """Return the layout of fewer muscles that serves, within all of the study's seconds; None where their number is
    given.

    What was found stands in the history: the same search is not shrunk twice.
    """
    best, choice = evaluations.best, study.muscles
    if not _may_shrink(study) or choice is None or best is None:
        return None
    evaluations.seconds = study.limits.seconds * (1 - (ROBUST if study.robust else 0.0))
    state = evaluations.history.load()
    known = state.get("fewer")
    if known and known["best"] == best.as_row() and known["seconds"] >= (evaluations.seconds if known["cut"] else 0):
        return kept_fewer(study, state)
    fewer = fewer_muscles(evaluations, least=choice.least, price=study.price)
    fewer = replace(_fewest(fewer, kept_fewer(study, state), study.price), front=tuple(evaluations.reached.front))
    outcome = {name: value for name, value in vars(fewer).items() if name != "start"}
    seconds = evaluations.seconds
    state["fewer"] = {"best": best.as_row(), "row": as_row(fewer.start), **outcome, "seconds": seconds}
    state |= evaluations.reached.rows()
    evaluations.history.save(state, evaluations.elapsed)
    return fewer


def _fewest(fewer: Fewer, earlier: Fewer | None, price: Price) -> Fewer:
    """Return `fewer`, with the layout that an earlier session came to where that serves still and is smaller, or as
    small and nearer."""
    if earlier is None or earlier.ended:
        return fewer

    def rank(option: Fewer) -> tuple[float, ...]:
        return len(option.start[0].design.muscles), option.start[0].channels, option.value

    allowed = price.allowed(fewer.before, fewer.count - len(earlier.start[0].design.muscles))
    if earlier.value > allowed or rank(earlier) >= rank(fewer):
        return fewer
    return replace(fewer, start=earlier.start, value=earlier.value, ended="")


def kept_fewer(study: Study, state: Mapping[str, Any]) -> Fewer | None:
    """Return what `shrunk` came to, as the history's state has it; None where it was not asked."""
    known = state.get("fewer")
    if known is None or not _may_shrink(study):
        return None
    start = of_row(known["row"], study.design, study.limits)
    front = tuple((count, value) for count, value in known.get("front", []))
    return Fewer(start, front=front, **{name: known[name] for name in ("value", "before", "count", "ended", "cut")})


def made_robust(how: Scattering, evaluations: Evaluations, points: Sequence[Start]) -> tuple[list[Start], int]:
    """Return `points` with the robust layout first, and how often one of its muscles was laid as two; within all of the
    study's seconds. What was found stands in the history."""
    study, history, best = how.study, evaluations.history, evaluations.best
    state = history.load() or {}
    known, row = state.get("robust"), None if best is None else best.as_row()
    if not known or known["best"] != row or known["seconds"] < study.limits.seconds:
        outcome = more_robust(
            how,
            points[most_robust(how, points)],
            tolerance=tolerance_of(how.robust, np.inf if best is None else best.value),
            going=lambda: evaluations.elapsed < study.limits.seconds,
        )
        known = {"best": row, "row": as_row(outcome.start), "doubled": outcome.doubled}
        state["robust"] = known | {"seconds": study.limits.seconds}
        history.save(state, evaluations.elapsed)
    return [of_row(known["row"], study.design, study.limits), *points], known["doubled"]


def _channels(count: int) -> str:
    return "1 channel" if count == 1 else f"{count} channels"


def fewer_in_words(study: Study, fewer: Fewer, *, converged: bool = True) -> str:
    """Return how many muscles serve, in words. converged: whether the search ended by itself, so that what it did not
    find is not enough."""
    space = fewer.start[0]
    count = len(space.design.muscles)
    bound = f"within {study.price.tolerance:.0%} of it" if not study.price.muscle else "for the price of a muscle"
    value, before = f"{in_mm(fewer.value):.2f} mm", f"{in_mm(fewer.before):.2f} mm"
    mm = f"{value} with either" if value == before else f"{value} instead of {before}, {bound}"
    if count < fewer.count:
        cut = ", not tried to the end" if fewer.cut else ""
        on = f" on {_channels(space.channels)}" if space.channels < count else ""
        return f"{count} muscles{on} are enough, where the search came to {fewer.count}: {mm}{cut}."
    if not fewer.ended:
        straight = "" if any(len(muscle.path) > 2 for muscle in space.design.muscles) else ", straight,"
        return f"The {count} muscles{straight} are enough on {_channels(space.channels)}: {mm}." + (
            " Fewer muscles are not enough." if converged else ""
        )
    if fewer.cut:
        return f"Layouts of fewer than {fewer.count} muscles were not tried to the end: {fewer.ended}."
    if not converged:
        return f"No layout of fewer than {fewer.count} muscles came {bound} so far."
    return f"Fewer than {fewer.count} muscles are not enough: no smaller layout came {bound}."
