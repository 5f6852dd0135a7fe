"""Fields of what is designed: pressures, the muscle that is selected, the model, a program under edit. Name, unit,
limits and sentence of a parameter are those of its declaration."""

from dataclasses import replace
from functools import partial
from pathlib import Path

from fabdesign.effects.declaration import EffectParameter
from fabdesign.effects.registry import EFFECTS
from studies.studio import layout as edits
from studies.studio.document import Document
from studies.studio.session import Session
from studies.studio.widgets.declared import KPA, MM, Widget, Widgets, buttons, choice, entry, folder, html
from studies.studio.widgets.status import error_over_time

NONE, SHEET, FILE = "none", "data sheet", "model file"


def pressures(document: Document) -> list[Widget]:
    """Return a slider for each channel."""
    layout = document.layout
    ends = zip(layout.pressures, edits.highest(layout.design), strict=True)
    return [
        entry(
            "slider", f"Channel {k}, kPa", min(pressure, end), partial(document.press, k), KPA,
            min=0.0, max=end, step=1.0,
        )
        for k, (pressure, end) in enumerate(ends)
    ]  # fmt: skip


def muscle(document: Document) -> list[Widget]:
    """Return the muscle that is selected: type, channel, face, ends and corners; adding, removing, undoing."""
    design, i, edit = document.layout.design, document.selected, document.edit_muscle
    one = None if i is None else design.muscles[i]
    names = tuple(f"{k}: {m.side}, channel {m.channel}" for k, m in enumerate(design.muscles)) or (NONE,)
    types, channel = tuple(design.muscle_types) or (NONE,), one.channel if one else 0
    points = [
        entry(
            "vector2", f"{edits.point_name(one, k).capitalize()} {k}", at,
            partial(edit, f"point {k} typed", edits.move_corner, k), MM, step=0.1,
        )
        for k, at in enumerate(one.path)
    ] if one else []  # fmt: skip

    def select(name: str) -> None:
        if name != NONE:
            document.select(names.index(name))

    def add() -> None:
        document.edit("add a muscle", lambda layout: edits.add_muscle(layout, i))
        document.select(len(document.layout.design.muscles) - 1)

    def spread(distance: float) -> None:
        document.set_option("row_distance", max(distance, edits.LEAST_SPACING))

    last = max(1, len(one.path) - 2) if one else 0  # of the corners between the ends
    changes = {"remove": partial(edit, "remove", edits.remove_muscle), "flip": partial(edit, "flip", edits.flip)}
    corners = {
        "add corner": partial(edit, "add a corner", edits.add_corner),
        "remove corner": partial(edit, "remove a corner", edits.remove_corner, last),
    }
    return [
        buttons("History", {"undo": document.undo, "redo": document.redo}),
        choice("Muscle", names, names[i or 0], select),
        buttons("Layout", {"add": add, **changes}),
        entry("text", "Face", one.side if one else "", disabled=True),
        choice("Type", types, one.type if one else types[0], lambda name: edit("type", edits.set_type, name)),
        entry("number", "Channel", channel, lambda to: edit("channel", edits.set_channel, int(to)), min=0, step=1),
        buttons("Corners", corners),
        folder("Ends and corners, mm from the upper left", *points),
        folder(
            "Lacing rows",
            entry("checkbox", "Snap to rows", document.snap, partial(document.set_option, "snap")),
            entry("number", "Rows, mm", document.row_distance, spread, MM, min=edits.LEAST_SPACING, max=0.1, step=0.5),
            closed=True,
        ),
    ]  # fmt: skip


def model(document: Document) -> list[Widget]:
    """Return data sheet or model file, and effects on switches with their parameters."""
    chosen = document.choice
    widgets = []
    if document.opened.model is not None:
        base = FILE if chosen.fitted else SHEET
        widgets.append(choice("Values", (FILE, SHEET), base, lambda name: document.choose(chosen.sheet(name == FILE))))
    if chosen.has_corrector:
        acts = chosen.model.corrector is not None or not chosen.corrected
        hint = "Exact shapes and motions" if acts else "Left out: it was trained beside other effects"

        def correct(on: bool) -> None:
            document.choose(replace(document.choice, corrected=on))

        widgets.append(entry("checkbox", "Corrector", chosen.corrected, correct, hint=hint))
    for name, effect in EFFECTS.items():
        if effect.site == "sensing":
            continue  # of sensors, which see no shape here
        values = chosen.effect_values.get(name, {})

        def switch(on: bool, name: str = name) -> None:
            document.choose(document.choice.switched(name, on))

        on = entry("checkbox", "On", name in chosen.effect_values, switch, hint=effect.what)
        fields = [_parameter(document, name, key, effect.parameters[key]) for key in sorted(values)]
        widgets.append(folder(name.replace("_", " "), on, *fields, closed=True))
    return widgets


def _parameter(document: Document, effect: str, key: str, declared: EffectParameter) -> Widget:
    unit = f", {declared.unit}" if declared.unit not in ("", "1") else ""
    low, high = declared.bounds

    def put(value: float) -> None:
        if effect in document.choice.effect_values:
            document.choose(document.choice.with_value(effect, key, float(value)))

    shown = min(max(round(document.choice.effect_values[effect][key], 6), low), high)
    return entry("number", f"{key.replace('_', ' ')}{unit}", shown, put, min=low, max=high, hint=declared.what)


def program(session: Session, made: Widgets) -> list[Widget]:
    """Return what stands beside the plot; nothing where no program is edited."""
    if (edit := session.program) is None:
        return []
    regulator = edit.moving.regulator
    channels = tuple(map(str, range(regulator.channels)))
    knots = tuple(f"{regulator.cycle * cycle:.2f}" for cycle in edit.knots)

    def save() -> None:
        path = Path(made.typed("Motion", "Program", "File").strip())
        made.unless_lost(f"{path} is there" if path.exists() else None, partial(edit.save, path))

    inside = [
        choice("Channel", channels, channels[edit.channel], lambda name: edit.select(int(name), edit.knot)),
        choice("Knot, s", knots, knots[edit.knot], lambda name: edit.select(edit.channel, knots.index(name))),
        entry(
            "slider", "Pressure, kPa", edit.pressure, edit.put, KPA,
            min=0.0, max=float(regulator.highest[edit.channel]), step=0.1,
        ),
        buttons("Play it over the target", {"coarse": edit.play, "exact": partial(edit.play, exact=True)}),
        html("error", error_over_time(session)),
        entry("text", "File", f"{edit.moving.study.name}_pressures.csv"),
        buttons("Program", {"save": save, "as it was opened": partial(edit.take, edit.moving.pressures)}),
    ]  # fmt: skip
    return [folder("Program", *inside)]
