"""The panel beside the scene, declared: each tab says its fields, and what a person's input does. Name, unit, limits
and sentence of an effect's parameter are those of its declaration."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from fabdesign.clouds.target_file import AsTarget
from fabdesign.effects.registry import EFFECTS
from fabdesign.geometry.placement import UNITS
from fabdesign.output import read_mark
from studies.studio import layout as edits
from studies.studio.document import Document
from studies.studio.model_choice import ModelChoice
from studies.studio.search import VARIES
from studies.studio.session import Session
from studies.studio.widgets import declared as ui
from studies.studio.widgets.declared import KPA, MM, PATH, Widget
from studies.studio.widgets.status import error_over_time, errors_table, profile, results_table, scale_bar, status

UnlessLost = Callable[[str | None, Callable[..., Any]], None]
NONE, SHEET, FILE, DRAWING = "none", "data sheet", "model file", "own drawing"
_SHIFT, _TURN, _TEMPLATE = "Shift, mm", "Turn, degrees", "Sewing template, 1:1"


def panel(session: Session, unless_lost: UnlessLost) -> list[Widget]:
    """Return all that stands beside the scene. unless_lost: writes, after asking where something would be lost by
    it."""
    document = session.document
    tabs = {
        "Layout": muscle(document),
        "Model": [ui.html("profile", profile(session)), *model(document)],
        "Target": target(session),
        "Results": results(document),
        "Motion": [*program(session, unless_lost), *motion(session)],
        "Files": files(session, unless_lost),
    }
    pages = [Widget("tab", name, inside=widgets) for name, widgets in tabs.items()]
    sliders, press = [], document.press
    for k, (now, end) in enumerate(zip(document.layout.pressures, edits.highest(document.layout.design), strict=True)):
        given: dict[str, Any] = {"min": 0.0, "max": end, "step": 1.0}
        sliders.append(ui.entry("slider", f"Channel {k}, kPa", min(now, end), partial(press, k), KPA, **given))
    return [*status(session), ui.folder("Pressures", *sliders), Widget("tab_group", inside=pages)]


def muscle(document: Document) -> list[Widget]:
    """Return the muscle that is selected: type, channel, face, ends and corners; adding, removing, undoing."""
    design, i, edit = document.layout.design, document.selected, document.edit_muscle
    one = None if i is None else design.muscles[i]
    names = tuple(f"{k}: {m.side}, channel {m.channel}" for k, m in enumerate(design.muscles)) or (NONE,)
    types = tuple(design.muscle_types) or (NONE,)
    points = []
    for k, at in enumerate(one.path if one else ()):
        name, put = edits.point_name(design.muscles[i or 0], k).capitalize(), partial(edit, f"point {k} typed")
        points.append(ui.entry("vector2", f"{name} {k}", at, partial(put, edits.move_corner, k), MM, step=0.1))

    def add() -> None:
        document.edit("add a muscle", lambda layout: edits.add_muscle(layout, i))
        document.select(len(document.layout.design.muscles) - 1)

    def spread(distance: float) -> None:
        document.set_option("row_distance", max(distance, edits.LEAST_SPACING))

    put_on = partial(edit, "channel", edits.set_channel)
    last = max(1, len(one.path) - 2) if one else 0  # of the corners between the ends
    changes = {"remove": partial(edit, "remove", edits.remove_muscle), "flip": partial(edit, "flip", edits.flip)}
    corners = {
        "add corner": partial(edit, "add a corner", edits.add_corner),
        "remove corner": partial(edit, "remove a corner", edits.remove_corner, last),
    }
    spacing: dict[str, Any] = {"min": edits.LEAST_SPACING, "max": 0.1, "step": 0.5}
    return [
        ui.buttons("History", {"undo": partial(document.step, -1), "redo": partial(document.step, 1)}),
        ui.choice("Muscle", names, names[i or 0], lambda name: document.select(names.index(name))),
        ui.buttons("Layout", {"add": add, **changes}),
        ui.entry("text", "Face", one.side if one else "", disabled=True),
        ui.choice("Type", types, one.type if one else types[0], partial(edit, "type", edits.set_type)),
        ui.entry("number", "Channel", one.channel if one else 0, put_on, min=0, step=1),
        ui.buttons("Corners", corners),
        ui.folder("Ends and corners, mm from the upper left", *points),
        ui.folder(
            "Lacing rows",
            ui.entry("checkbox", "Snap to rows", document.snap, partial(document.set_option, "snap")),
            ui.entry("number", "Rows, mm", document.row_distance, spread, MM, **spacing),
            closed=True,
        ),
    ]


def model(document: Document) -> list[Widget]:
    """Return data sheet or model file, and effects on switches with their parameters."""
    chosen, widgets = document.choice, []

    def chooses(change: Callable[..., ModelChoice], *given: str) -> Callable[[Any], None]:
        """Return what changes the choice that holds then."""
        return lambda value: document.choose(change(document.choice, *given, value))

    if document.opened.model is not None:
        base, choose = FILE if chosen.fitted else SHEET, chooses(lambda choice, name: choice.sheet(name == FILE))
        widgets.append(ui.choice("Values", (FILE, SHEET), base, choose))
    if chosen.has_corrector:
        acts = chosen.model.corrector is not None or not chosen.corrected
        hint = "Exact shapes and motions" if acts else "Left out: it was trained beside other effects"
        correct = chooses(lambda choice, on: replace(choice, corrected=on))
        widgets.append(ui.entry("checkbox", "Corrector", chosen.corrected, correct, hint=hint))
    for name, effect in EFFECTS.items():
        if effect.site == "sensing":
            continue  # of sensors, which see no shape here
        switch, values = chooses(ModelChoice.switched, name), chosen.effect_values.get(name)
        fields = [ui.entry("checkbox", "On", values is not None, switch, hint=effect.what)]
        for key, value in sorted((values or {}).items()):
            declared, put = effect.parameters[key], chooses(ModelChoice.with_value, name, key)
            label = key.replace("_", " ") + (f", {declared.unit}" if declared.unit not in ("", "1") else "")
            (low, high), hint = declared.bounds, declared.what
            shown = min(max(round(value, 6), low), high)
            fields.append(ui.entry("number", label, shown, put, min=low, max=high, hint=hint))
        widgets.append(ui.folder(name.replace("_", " "), *fields, closed=True))
    return widgets


def target(session: Session) -> list[Widget]:
    """Return the target: opened, placed by fit or by hand, and searched for from here."""
    document, search = session.document, session.search
    file = None if document.target is None else document.target.file
    poses = tuple(f"{number}: {target.file.file.name}" for number, target in enumerate(document.targets))

    def open_as(place: Any, file: Path, unit: Any) -> None:
        document.open_target(AsTarget(unit, place).target(file) if file.name else None)

    def place(shift: Any, turn: Any, _: Any) -> None:
        document.place_target(turn, shift)

    still, placing = (0.0, 0.0, 0.0), (_SHIFT, _TURN)
    drag = "Drag it by arrows and rings in the scene"
    shown = (*poses, NONE)[document.pose]
    pose = ui.choice("Pose", poses or (NONE,), shown, lambda name: document.show_pose((*poses, name).index(name)))
    return [
        *([pose] if len(document.opened.targets) > 1 else []),
        ui.entry("text", "File", file.file if file else "", unit=PATH),
        ui.choice("Unit", tuple(UNITS), file.unit if file else "m"),
        ui.buttons("Open", {"as given": partial(open_as, "given"), "fit": partial(open_as, "fit")}, "File", "Unit"),
        ui.folder(
            "Placed by hand",
            ui.entry("checkbox", "Gizmo", document.gizmo, partial(document.set_option, "gizmo"), hint=drag),
            ui.entry("vector3", _SHIFT, file.translation if file else still, place, MM, placing, step=0.5),
            ui.entry("vector3", _TURN, (file and file.rotation) or still, place, None, placing, step=1.0),
            closed=True,
        ),
        ui.folder(
            "Search from here",
            ui.choice("May change", VARIES, VARIES[0]),
            ui.entry("number", "Seconds", 120.0, min=1.0, max=86400.0, step=10.0),
            ui.button("Search from here", search.start, "May change", "Seconds", disabled=search.running),
            ui.button("Stop, keep the best", search.stop, disabled=not search.running),
            ui.words("message", search.message),
        ),
    ]


def results(document: Document) -> list[Widget]:
    """Return the results of searches, beside the own drawing."""
    by_name = {result.name: result for result in document.results}
    lines = [f"{result.name}: {result.state}" for result in document.results]
    lines += filter(None, map(document.one_more_buys, document.results))
    nothing = "Nothing yet: *Search from here* under *Target*. An edit of a result takes it as own drawing."
    shown, beside = DRAWING if document.shown is None else document.shown.name, partial(document.set_option, "beside")
    hint = "Its shape, seen through"
    return [
        ui.choice("Shown", (DRAWING, *by_name), shown, lambda name: document.show_result(by_name.get(name))),
        ui.entry("checkbox", "The other one beside it", document.beside, beside, hint=hint),
        ui.button("Take as own drawing", document.take, disabled=document.shown is None),
        ui.html("table", results_table(document)),
        ui.words("message", "\n\n".join(lines) or nothing),
    ]


def program(session: Session, unless_lost: UnlessLost) -> list[Widget]:
    """Return what stands beside the plot; nothing where no program is edited."""
    if (edit := session.program) is None:
        return []
    regulator, highest = edit.moving.regulator, float(edit.moving.regulator.highest[edit.channel])
    channels = tuple(map(str, range(regulator.channels)))
    knots = tuple(f"{regulator.cycle * cycle:.2f}" for cycle in edit.knots)

    def save(path: Path) -> None:
        unless_lost(f"{path} is there" if path.exists() else None, partial(edit.save, path))

    def opened(_: Path) -> None:
        edit.take(edit.moving.pressures)

    inside = [
        ui.choice("Channel", channels, channels[edit.channel], lambda name: edit.select(int(name), edit.knot)),
        ui.choice("Knot, s", knots, knots[edit.knot], lambda name: edit.select(edit.channel, knots.index(name))),
        ui.entry("slider", "Pressure, kPa", edit.pressure, edit.put, KPA, min=0.0, max=highest, step=0.1),
        ui.buttons("Play it over the target", {"coarse": edit.play, "exact": partial(edit.play, "motion")}),
        ui.html("error", error_over_time(session)),
        ui.entry("text", "File", f"{edit.moving.study.name}_pressures.csv", unit=PATH),
        ui.buttons("Program", {"save": save, "as it was opened": opened}, "File"),
    ]
    return [ui.folder("Program", *inside)]


def motion(session: Session) -> list[Widget]:
    """Return the motion: played, scrubbed through, written."""
    playing, trials = session.playing, tuple(session.document.trials)
    shown, given, scale, text, last = playing.motion, session.document.opened.program, "", "", 1
    if shown is not None:
        last = max(1, len(shown.times) - 1)
        beside = "" if shown.ghost(playing.frame) is None else "; orange: without the corrector"
        text = shown.in_words(playing.frame) + beside
        if shown.largest is not None:
            scale = scale_bar(shown.largest, "measured point to the shown surface")
    of_trials = [
        ui.choice("Trial", trials, trials[0]),
        ui.button("Show measured and predicted", playing.trial, "Trial"),
        ui.button("Errors of all trials", playing.all_errors),
    ] if trials else []  # fmt: skip
    frames: dict[str, Any] = {"min": 0, "max": last, "step": 1, "disabled": shown is None}
    opened = [ui.button("Play the pressures of the command line", partial(playing.opened, given))] if given else []
    return [
        ui.button("Play the rise to these pressures", playing.rise),
        *opened,
        ui.entry("text", "Pressures file", "", unit=PATH),
        ui.button("Play the file", playing.file, "Pressures file"),
        *of_trials,
        ui.button("Play" if shown and not playing.running else "Pause", playing.toggle, disabled=shown is None),
        ui.entry("slider", "Frame", playing.frame if shown else 0, playing.scrub, **frames),
        ui.words("frame", text),
        ui.html("scale", scale),
        ui.folder(
            "For other programs",
            ui.entry("text", "File", "motion.glb", unit=PATH, hint=".glb, .pvd, .rrd, .csv, .html or .png"),
            ui.button("Write the motion", playing.write, "File"),
            closed=True,
        ),
        ui.words("errors", errors_table(playing.errors)),
    ]


def files(session: Session, unless_lost: UnlessLost) -> list[Widget]:
    """Return the files: saved, exported, taken again."""
    document, saving = session.document, session.files
    state = "unsaved changes, kept in an autosave" if document.history.changed else "nothing unsaved"
    undo = f"; undo: {document.history.next_undo}" if document.history.next_undo else ""

    def save(folder: Path) -> None:
        unless_lost(saving.replaces(folder), partial(saving.save, folder))

    def export(folder: Path) -> None:
        mark = read_mark(folder)
        reason = None if mark is None else f"{folder} holds what `fabdesign {mark.made_by}` wrote"
        unless_lost(reason, partial(saving.save_template, folder))

    return [
        ui.entry("text", "Folder", saving.folder, unit=PATH),
        ui.button("Save", save, "Folder"),
        ui.button("Load from disk", saving.load_again),
        ui.words("state", f"`{document.opened.file}`: {state}{undo}"),
        ui.folder(
            _TEMPLATE,
            ui.entry("text", "Folder", saving.template_folder, unit=PATH),
            ui.button("Export template", export, "Folder"),
        ),
    ]
