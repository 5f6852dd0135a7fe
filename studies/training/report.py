"""The result of a training, in words."""

from fabdesign.units import in_mm
from studies.training.train import HeldOutErrors, TrainingResult


def as_text(result: TrainingResult) -> str:
    """Return lines for a person: what was learned from what, and what it is worth on trials that took no part."""
    lines = [
        f"{result.about['network']} corrector on {result.base}, {result.learned_from} trials learned from"
        + ("" if result.held_out else "; no trial was held out, so nothing says what it is worth")
    ]
    lines += [_line(name, of, ordered=result.about["network"] == "field") for name, of in result.held_out.items()]
    for one in result.about["left_out"]:
        lines.append(
            f"design {one['design']} left out: {one['before_mm']:.2f} to {one['after_mm']:.2f} mm along the normal, "
            f"at a distance of {one['distance']:.2f}"
        )
    if result.about["network"] == "field":
        lines.append(
            f"designs farther than {result.about['trust_limit']:.2f} from those learned from are not corrected"
        )
    lines.append(result.intervals)
    if result.used.stretches is not None:
        lines.append(result.used.in_words)
    return "\n".join(lines)


def _line(name: str, of: HeldOutErrors, *, ordered: bool) -> str:
    before, after = of.before, of.after
    trials = f"{of.trials} trial{'s' * (of.trials != 1)} of {name} held out"
    if not ordered:
        return (
            f"{trials}: Chamfer {in_mm(before.chamfer):.2f} to {in_mm(after.chamfer):.2f} mm (floor "
            f"{in_mm(before.chamfer_floor):.2f})"
        )
    share = "" if of.closed.surface is None else f", {of.closed.surface:.0%} of the excess error removed"
    far = "" if of.trust.applies else f"; {of.trust.distance:.2f} from what was learned, too far: not corrected"
    sheet = "" if of.sheet is None else f"data sheet {in_mm(of.sheet.surface_rms):.2f}, base and corrector "
    return (
        f"{trials}: surface RMS {sheet}{in_mm(before.surface_rms):.2f} to {in_mm(after.surface_rms):.2f} mm (floor "
        f"{in_mm(after.surface_floor):.2f}){share}{far}"
    )
