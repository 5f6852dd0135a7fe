"""Where a search stands, and how that is kept: the same search goes on after its last round."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, TypedDict

import numpy as np

from fabdesign.formats.json_file import plain
from fabdesign.nouns.design import Design
from fabdesign.nouns.muscle import Muscle
from optimize.search.design_space import DesignSpace
from optimize.search.evaluations import Evaluations
from optimize.search.local_search import LocalSearch
from optimize.search.margins import Limits
from optimize.search.starts import Start

# of restart k = 1, 2, ... and the best so far: starts, and whether they owe nothing to the best
FurtherStarts = Callable[[int, Start], tuple[Sequence[Start], bool]]


@dataclass
class SearchState:
    """Where a search stands."""

    stage: int = 0
    searches: list[LocalSearch] = field(default_factory=list)
    first: int = 0  # of the starts, that the restart under way began with
    independent: bool = True  # whether these owe nothing to what was best
    bests: list[list[Any]] = field(default_factory=list)  # of the restarts after the first: what was best before each
    ends: list[float] = field(default_factory=list)  # m, of searches from new starts on the last stage
    reason: str = ""  # why it ended
    fewer: Any = None  # what leaving muscles out came to, as it was kept last


def add_starts(evaluations: Evaluations, at: SearchState, further: FurtherStarts) -> None:
    """Add the starts of the last restart of `at`."""
    start, x, _, stage = at.bests[-1]
    new, at.independent = further(len(at.bests), (evaluations.space(start, stage), np.array(x)))
    at.first = len(evaluations.starts)
    evaluations.starts += new


def save_state(evaluations: Evaluations, at: SearchState) -> None:
    """Write the state into the history of `evaluations`, after a round."""
    rows = [
        [s.start, s.x.tolist(), s.value, s.radius, s.rounds, s.done, *plain([s.slopes_at, s.learned])]
        for s in at.searches
    ]
    state = {
        "stage": at.stage,
        **evaluations.reached.rows(),
        "searches": rows,
        "bests": at.bests,
        "ends": at.ends,
        "began": evaluations.restart_began,
        "reason": at.reason,
        "fewer": at.fewer,
    }
    evaluations.history.save(state, evaluations.elapsed)


def load_state(evaluations: Evaluations, further: FurtherStarts | None) -> SearchState:
    """Return the state as it was kept, with the best of `evaluations`; a search at its begin where nothing was."""
    state: Any = evaluations.history.load()
    at = SearchState()
    if state is None:
        return at
    if further is not None:
        for best in state["bests"]:
            at.bests.append(best)
            add_starts(evaluations, at, further)
    at.stage, at.ends, at.reason = state["stage"], state["ends"], state["reason"]
    at.fewer = state.get("fewer")
    evaluations.restart_began = state["began"]
    evaluations.reached.take(state)
    at.searches = [
        LocalSearch(
            start,
            evaluations.space(start, at.stage),
            np.array(x),
            value,
            radius,
            rounds,
            done,
            slopes_at=None if slopes_at is None else np.array(slopes_at),
            learned=[np.array(x) for rows in learned for x in rows],
        )
        for start, x, value, radius, rounds, done, slopes_at, *learned in state["searches"]
    ]
    return at


class StartRow(TypedDict):
    """A layout and its pressures."""

    muscles: list[dict[str, Any]]  # what a Muscle is made of
    pressures: list[list[float]]  # Pa, of each pose


def as_row(start: Start) -> StartRow:
    """Return muscles, and (poses, channels) pressures in Pa."""
    design, pressures = start[0].decode(start[1])
    return {"muscles": [asdict(muscle) for muscle in design.muscles], "pressures": pressures.tolist()}


def of_row(row: StartRow, cloth: Design, limits: Limits) -> Start:
    """Return what `as_row` gave, on the cloth and with the muscle types of a design."""
    muscles = [Muscle(**{**keys, "path": ()}).along(keys["path"]) for keys in row["muscles"]]
    design, pressures = replace(cloth, muscles=tuple(muscles)), np.array(row["pressures"], dtype=float)
    space = DesignSpace(design, limits, pressures, vary_positions=True)
    return space, space.encode(design, pressures)
