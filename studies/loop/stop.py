"""When the loop ends."""

from collections.abc import Sequence

from fabdesign.loop_file import StopRule


def stop_reason(rule: StopRule, excess: Sequence[float]) -> str | None:
    """In a sentence, of the excess [m] on the device after each turn, the first design's first; None: it goes on."""
    *before, now = excess
    if now <= rule.excess:
        return f"near enough: {1e3 * now:.2f} mm over the noise floor on the device, within {1e3 * rule.excess:g} mm"
    if len(before) >= rule.turns:
        return f"turns used: {rule.turns}"
    if before and now > (1 - rule.gain) * min(before):
        return (
            f"no further gain: {1e3 * now:.2f} mm over the noise floor on the device, {1e3 * min(before):.2f} before; "
            f"a turn that gains less than {rule.gain:.0%} is the last"
        )
    return None
