"""Effects as people read them: a list, and each with its parameters."""

from fabdesign.effects.declaration import Effect, EffectParameter


def as_text(effects: dict[str, Effect]) -> str:
    """Return a line each, by site."""
    width = max(len(name) for name in effects)
    lines = []
    for site in dict.fromkeys(effect.site for effect in effects.values()):
        lines.append(f"{site}:")
        lines += [f"  {e.name:<{width}}  {e.what}" for e in effects.values() if e.site == site]
    return "\n".join(lines)


def one_as_text(effect: Effect) -> str:
    """Return all that is declared of one effect."""
    head = [
        f"{effect.name} ({effect.site}; belongs to the {effect.scope})",
        f"what it is: {effect.what}",
        f"in data: {effect.signature}",
        *([f"looks like: {effect.looks_like}"] if effect.looks_like else []),
        f"source: {effect.source}",
        "parameters:",
    ]
    return "\n".join([*head, *(f"  {name}: {in_words(p)}" for name, p in effect.parameters.items())])


def in_words(p: EffectParameter) -> str:
    unit = "" if p.unit == "1" else f" {p.unit}"
    low, high = p.bounds
    if p.whole:
        return f"{p.what}; a whole number, chosen, not fitted; {p.typical:g} by default"
    spread = f"a factor of e^{p.deviation:g}" if p.transform == "log" else f"{p.deviation:g}{unit}"
    off = "" if p.off is None else f", off at {p.off:g}"
    return f"{p.what}; {p.typical:g}{unit} by default{off}; {low:g} to {high:g}{unit}; prior {p.centre:g} +- {spread}"


def markdown_table(effects: dict[str, Effect]) -> str:
    """Return the table of docs/effects.md."""
    rows = [
        "| effect | site | scope | parameters (unit: default) | what it is | what looks the same, and how to tell |",
        "|---|---|---|---|---|---|",
    ]
    for effect in effects.values():
        listed = ", ".join(
            f"`{name}` ({'' if p.unit == '1' else p.unit + ': '}{p.typical:g})" for name, p in effect.parameters.items()
        )
        rows.append(
            f"| `{effect.name}` | {effect.site} | {effect.scope} | {listed} | {effect.what} | {effect.looks_like} |"
        )
    return "\n".join(rows)
