"""Results of searches from here: each a drawing of its own, beside the one that is edited."""

from collections.abc import Sequence
from dataclasses import dataclass

from fabdesign.units import in_mm
from studies.studio.layout import Layout
from studies.studio.live import LiveShape
from studies.studio.target import Comparison


@dataclass(eq=False)
class Seen:
    """A drawing's last exact shape, and how far it is from the target."""

    shape: LiveShape | None = None
    comparison: Comparison | None = None

    def forget(self) -> None:
        """Drop both: they were under another model, or beside another target."""
        self.shape = self.comparison = None


@dataclass(eq=False)
class Result(Seen):
    """layouts: the best so far, one for each pose; at first where the search began. objective: m; None: none yet."""

    name: str = ""
    begun: Layout | None = None
    layouts: tuple[Layout, ...] = ()
    objective: float | None = None
    state: str = ""  # in words

    def layout(self, pose: int) -> Layout:
        """Return the layout of a pose, or of the last one."""
        return self.layouts[min(pose, len(self.layouts) - 1)]

    def hold(self, layouts: tuple[Layout, ...], objective: float) -> None:
        """Take a better result in."""
        if layouts != self.layouts:
            self.forget()
        self.layouts, self.objective = layouts, objective

    @property
    def muscles(self) -> int:
        return len(self.layouts[0].design.muscles)


@dataclass(frozen=True)
class Row:
    """A row of the table that compares drawings. Distances in m; None: not known yet. highest: Pa."""

    name: str
    muscles: int
    chamfer: float | None
    surface_rms: float | None
    highest: float
    shown: bool

    @staticmethod
    def of(name: str, layout: Layout, seen: Seen, *, shown: bool, objective: float | None = None) -> "Row":
        """Make the row of a drawing. objective: m, Chamfer as a search has it, until the shape was seen."""
        errors = None if seen.comparison is None else seen.comparison.errors
        chamfer = objective if errors is None else errors.chamfer
        rms = None if errors is None else errors.surface_rms
        return Row(name, len(layout.design.muscles), chamfer, rms, max(layout.pressures, default=0.0), shown)


def one_more_buys(result: Result, others: Sequence[Result], drawn: Row | None) -> str | None:
    """Return in words what one more muscle buys, against the best with the muscles that the search began with, searched
    or drawn; None where the result has no more of them, or nothing is there to compare it with. drawn: the own drawing;
    None where its figure is not the search's, a mean over poses."""
    count = len(result.begun.design.muscles) if result.begun else 0
    if result.objective is None or result.begun is None or result.muscles <= count:
        return None
    rivals = [(o.objective, o.name) for o in others if o.objective is not None and o.muscles == count]
    if drawn is not None and drawn.chamfer is not None and drawn.muscles == count:
        rivals.append((drawn.chamfer, drawn.name))
    if not rivals:
        return None
    before, name = min(rivals)
    less = in_mm(before - result.objective)
    change = f"{less:.2f} mm less" if less >= 0 else f"{-less:.2f} mm more"
    by_hand = drawn is not None and name == drawn.name
    searched = "; for a fair comparison search from here without one more as well" if by_hand else ""
    return (
        f"One more muscle: Chamfer {in_mm(result.objective):.2f} mm with {result.muscles} muscles, {change} than "
        f"{in_mm(before):.2f} mm with {count} ({name}){searched}."
    )
