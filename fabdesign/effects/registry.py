"""Effects by name: those of fabdesign, those of installed packages, and those that a file brings in; and as people read
them."""

import atexit
import importlib
import importlib.util
import shutil
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from fabdesign.effects.declaration import Effect, EffectParameter, Values, built_in, to_constants, to_muscles
from fabdesign.errors import InputError
from fabdesign.formats.table import nearest
from fabdesign.nouns.design import Term

GROUP = "fabdesign.effects"  # entry points of installed packages, each an Effect


def _named(place: str) -> Any:
    """Return what a module holds by a name, "module:NAME"."""
    module, name = place.split(":")
    return getattr(importlib.import_module(module), name)


def _effect(name: str, table: dict[str, Any]) -> Effect:
    """Return the effect that a table of data/effects.toml declares."""
    keys = {**built_in()[table["like"]], **table} if "like" in table else {**table}
    keys.pop("like", None)
    keys["parameters"] = {key: _parameter(one) for key, one in keys["parameters"].items()}
    keys |= {act: _named(keys[act]) for act in ("pressure", "specimen", "clock", "observed", "bench") if act in keys}
    for key, change in (("to_muscles", to_muscles), ("to_constants", to_constants)):
        if key in keys:
            keys["specimen"] = change(**keys.pop(key))
    return Effect(name, **keys)


def _parameter(keys: dict[str, Any]) -> EffectParameter:
    return EffectParameter(**keys | {key: tuple(value) for key, value in keys.items() if isinstance(value, list)})


EFFECTS: dict[str, Effect] = {name: _effect(name, table) for name, table in built_in().items()}
BUILT_IN = tuple(EFFECTS)
_files: dict[str, str] = {}  # text of the files that were registered, by stem


def register(effect: Effect, where: str = "register") -> None:
    """Register one more. Raises InputError for a name that another effect has."""
    if EFFECTS.setdefault(effect.name, effect) is not effect:
        raise InputError(f"{where}: effect {effect.name}: there is one of this name already; expected another name")


def register_installed() -> None:
    """Register the effects that installed packages declare as entry points of `fabdesign.effects`."""
    import importlib.metadata  # costs 30 ms

    for point in importlib.metadata.entry_points(group=GROUP):
        effect = point.load()
        if not isinstance(effect, Effect):
            raise InputError(f"entry point {point.value}: {type(effect).__name__}; expected a fabdesign.effects.Effect")
        register(effect, f"entry point {point.value}")


def register_file(path: Path | str) -> None:
    """Register all effects that a Python file declares at its top level; the file is run. Raises InputError."""
    path = Path(path).resolve()
    if not path.is_file() or path.suffix != ".py":
        raise InputError(f"{path}: expected a Python file with effects")
    module: Any
    name = f"fabdesign_effects_{path.stem}"
    if (module := sys.modules.get(name)) is None or module.__file__ != str(path):
        spec = importlib.util.spec_from_file_location(name, path)
        if spec is None:
            raise InputError(f"{path}: expected a Python file with effects")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        try:
            exec(compile(path.read_bytes(), str(path), "exec"), vars(module))  # a loader leaves __pycache__ beside it
        except Exception as error:
            del sys.modules[name]
            raise InputError(f"{path}: {type(error).__name__}: {error}; expected a file that Python runs") from error
    declared = [value for value in vars(module).values() if isinstance(value, Effect)]
    if not declared:
        raise InputError(f"{path}: declares no effect; expected a fabdesign.effects.Effect at its top level")
    for effect in declared:
        register(effect, str(path))
    _files[path.stem] = path.read_text(encoding="utf-8")


def registered_sources() -> tuple[tuple[str, str], ...]:
    """Return (stem, text) of every file that was registered: what another process needs to know the same effects."""
    return tuple(sorted(_files.items()))


def register_source(stem: str, text: str) -> None:
    """Register, as `register_file`, a file that another process registered. Raises InputError."""
    if _files.get(stem) == text:
        return
    folder = Path(tempfile.mkdtemp(prefix="fabdesign_effects_"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    (folder / f"{stem}.py").write_text(text, encoding="utf-8")  # Taichi reads the text of a force
    register_file(folder / f"{stem}.py")


def effect_named(name: str, where: str) -> Effect:
    """Return the effect; installed packages are asked for it last. Raises InputError for an unknown name, with the
    nearest one."""
    if name not in EFFECTS:
        register_installed()
    if name not in EFFECTS:
        known = [*EFFECTS]
        raise InputError(f"{where}: unknown effect {name}; expected one of {', '.join(known)}{nearest(name, known)}")
    return EFFECTS[name]


def check_values(effect: Effect, values: Values, where: str) -> None:
    """Raise InputError for a parameter that the effect does not have, or a value beyond its bounds."""
    for name, value in values.items():
        if name not in effect.parameters:
            known = [*effect.parameters]
            raise InputError(
                f"{where}: {effect.name} has no parameter {name}; expected {', '.join(known)}{nearest(name, known)}"
            )
        parameter = effect.parameters[name]
        low, high = parameter.bounds
        if not low <= value <= high:
            raise InputError(
                f"{where}: {effect.name} {name} = {value:g} {parameter.unit}; expected {low:g} to {high:g} "
                f"{parameter.unit}"
            )
        if parameter.integer and value != int(value):
            raise InputError(f"{where}: {effect.name} {name} = {value:g}; expected a whole number")


def force_of(effect: Effect) -> Any:
    """Return the kernel's part of an effect, imported where it is named only; None where it has none."""
    return _named(effect.force) if isinstance(effect.force, str) else effect.force


def label_effect(label: str) -> str:
    """Return the effect's name in the label of one of its terms."""
    return label.partition(":")[0]


def effects_of(labels: Iterable[str]) -> list[str]:
    """Return the effects' names in labels of terms, each once."""
    return [*dict.fromkeys(label_effect(label) for label in labels)]


def acting_effects(terms: Iterable[Term]) -> list[str]:
    """Return the names of the effects that change anything, each once."""
    return [*dict.fromkeys(term.name for term in terms if not EFFECTS[term.name].is_off(term.values))]


def labels_of(terms: Sequence[Term]) -> tuple[str, ...]:
    """Return the label of each term: its effect's name; of several of one effect "NAME:VALUE,..." by its chosen
    parameters."""
    names = [term.name for term in terms]
    return tuple(term.name if names.count(term.name) == 1 else f"{term.name}:{_chosen(term)}" for term in terms)


def _chosen(term: Term) -> str:
    effect = EFFECTS[term.name]
    return ",".join(f"{effect.values(term.values)[name]:g}" for name in effect.chosen)


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
    """Return unit, bounds and prior of a parameter."""
    unit = "" if p.unit == "1" else f" {p.unit}"
    low, high = p.bounds
    if p.integer:
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
