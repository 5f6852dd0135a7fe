"""The panel beside the scene, declared from what it edits: each tab says its fields, their units and limits, and what a
person's input does."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, Protocol

from fabdesign.effects.declaration import EffectParameter
from fabdesign.effects.registry import EFFECTS
from fabdesign.output import read_mark
from fabdesign.placement import UNITS
from fabdesign.target_file import AsTarget
from fabdesign.units import from_kpa, from_mm, in_kpa, in_mm
from studies.studio.declared import Widget, button, buttons, entry, folder, html, words
from studies.studio.hung_view import LEAST_SCALE
from studies.studio.layout import (
    LEAST_SPACING,
    Layout,
    add_corner,
    add_muscle,
    flip,
    highest,
    move_corner,
    point_name,
    remove_corner,
    remove_muscle,
    set_channel,
    set_type,
)
from studies.studio.measured import errors_table
from studies.studio.results import Row, one_more_buys
from studies.studio.search import VARIES
from studies.studio.session import Session
from studies.studio.status import profile, scale_bar, status

NONE, OWN, SHEET, FILE = "none", "own drawing", "data sheet", "model file"
_SHIFT, _TURN, _TEMPLATE = "Shift, mm", "Turn, degrees", "Sewing template, 1:1"


class Hands(Protocol):
    """What the panel asks of the page. gizmo: whether the target has one."""

    gizmo: bool

    def typed(self, *names: str) -> Any:
        """Return what stands in an input, by its name and those of what it lies in."""

    def unless_lost(self, reason: str | None, write: Callable[..., Any]) -> None:
        """Call `write(replace=...)`, after asking where something would be lost by it."""

    def set_gizmo(self, on: bool) -> None: ...


class Panel:
    """All that stands beside the scene."""

    def __init__(self, session: Session, hands: Hands) -> None:
        self._session, self._document, self._hands = session, session.document, hands

    def widgets(self) -> list[Widget]:
        tabs = {
            "Layout": self._layout(),
            "Model": [html("profile", profile(self._session)), *self._model()],
            "Target": self._target(),
            "Results": self._results(),
            "Motion": self._motion(),
            "Files": self._files(),
        }
        pages = [Widget("tab", name, inside=widgets) for name, widgets in tabs.items()]
        sliders = folder("Pressures", *self._pressures())
        return [*status(self._session), sliders, Widget("tab_group", inside=pages)]

    def _pressures(self) -> list[Widget]:
        layout = self._document.layout
        sliders = []
        for channel, (pressure, end) in enumerate(zip(layout.pressures, highest(layout.design), strict=True)):
            limits = {"min": 0.0, "max": round(in_kpa(end), 1), "step": 1.0}
            value = round(in_kpa(min(pressure, end)), 1)
            sliders.append(entry("slider", f"Channel {channel}, kPa", value, partial(self._press, channel), **limits))
        return sliders

    def _press(self, channel: int, kilopascals: float) -> None:
        self._document.press(channel, from_kpa(kilopascals))

    # Layout: the muscle that is selected

    def _layout(self) -> list[Widget]:
        document, edit = self._document, self._document.edit_muscle
        design, i = document.layout.design, document.selected
        muscle = None if i is None else design.muscles[i]
        names = tuple(f"{k}: {m.side}, channel {m.channel}" for k, m in enumerate(design.muscles)) or (NONE,)
        types, channel = tuple(design.muscle_types) or (NONE,), 0 if muscle is None else muscle.channel
        corners = {"add corner": ("add a corner", add_corner), "remove corner": ("remove a corner", _without_corner)}
        return [
            buttons("History", {"undo": document.undo, "redo": document.redo}),
            _choice("Muscle", names, names[i or 0], self._select),
            buttons(
                "Layout",
                {
                    "add": self._add,
                    "remove": partial(edit, "remove", remove_muscle),
                    "flip": partial(edit, "flip", flip),
                },
            ),
            entry("text", "Face", "" if muscle is None else muscle.side, disabled=True),
            _choice("Type", types, muscle.type if muscle else types[0], lambda name: edit("type", set_type, name)),
            entry("number", "Channel", channel, lambda to: edit("channel", set_channel, int(to)), min=0, step=1),
            buttons("Corners", {label: partial(edit, *change) for label, change in corners.items()}),
            folder("Ends and corners, mm from the upper left", *self._points()),
            folder("Lacing rows", *self._rows(), closed=True),
        ]

    def _points(self) -> list[Widget]:
        i = self._document.selected
        muscle = None if i is None else self._document.layout.design.muscles[i]
        fields = []
        for k, (u, v) in enumerate(muscle.path if muscle is not None else ()):
            assert muscle is not None
            at, label = (round(in_mm(u), 3), round(in_mm(v), 3)), f"{point_name(muscle, k).capitalize()} {k}"
            fields.append(entry("vector2", label, at, partial(self._put_point, k), step=0.1))
        return fields

    def _put_point(self, point: int, at: tuple[float, float]) -> None:
        to = from_mm(at[0]), from_mm(at[1])
        self._document.edit_muscle(f"point {point} typed", move_corner, point, to)

    def _rows(self) -> list[Widget]:
        limits = {"min": in_mm(LEAST_SPACING), "max": 100.0, "step": 0.5}
        distance = in_mm(self._document.row_distance)

        def spread(millimetres: float) -> None:
            self._document.set_option("row_distance", max(from_mm(millimetres), LEAST_SPACING))

        return [
            entry("checkbox", "Snap to rows", self._document.snap, partial(self._document.set_option, "snap")),
            entry("number", "Rows, mm", distance, spread, **limits),
        ]

    def _select(self, name: str) -> None:
        if name != NONE:
            self._document.select(int(name.partition(":")[0]))

    def _add(self) -> None:
        document = self._document
        document.edit("add a muscle", lambda layout: add_muscle(layout, document.selected))
        document.select(len(document.layout.design.muscles) - 1)

    # Model: data sheet or file, and effects on switches

    def _model(self) -> list[Widget]:
        document, choice = self._document, self._document.choice
        widgets = []
        if document.opened.model is not None:
            base = FILE if choice.fitted else SHEET
            widgets.append(
                _choice("Values", (FILE, SHEET), base, lambda name: document.choose(choice.sheet(name == FILE)))
            )
        if choice.has_corrector:
            acts = choice.model.corrector is not None or not choice.corrected
            hint = "Exact shapes and motions" if acts else "Left out: it was trained beside other effects"

            def correct(on: bool) -> None:
                document.choose(replace(document.choice, corrected=on))

            widgets.append(entry("checkbox", "Corrector", choice.corrected, correct, hint=hint))
        for name, effect in EFFECTS.items():
            if effect.site == "sensing":
                continue  # of sensors, which see no shape here
            values = choice.effect_values.get(name, {})
            on = entry("checkbox", "On", name in choice.effect_values, partial(self._switch, name), hint=effect.what)
            fields = [self._parameter(name, key, effect.parameters[key], values[key]) for key in sorted(values)]
            widgets.append(folder(name.replace("_", " "), on, *fields, closed=True))
        return widgets

    def _switch(self, effect: str, on: bool) -> None:
        self._document.choose(self._document.choice.switched(effect, on))

    def _parameter(self, effect: str, key: str, declared: EffectParameter, value: float) -> Widget:
        """Return the field of a parameter: name, unit, limits and sentence are those of its declaration."""
        unit = f", {declared.unit}" if declared.unit not in ("", "1") else ""
        low, high = declared.bounds

        def put(value: float) -> None:
            choice = self._document.choice
            if effect in choice.effect_values:
                self._document.choose(choice.with_value(effect, key, float(value)))

        label, shown = f"{key.replace('_', ' ')}{unit}", min(max(round(value, 6), low), high)
        return entry("number", label, shown, put, min=low, max=high, hint=declared.what)

    # Target: opened, placed by fit or by hand, and searched for from here

    def _target(self) -> list[Widget]:
        document, search, typed = self._document, self._session.search, partial(self._hands.typed, "Target")
        file = None if document.target is None else document.target.file
        poses = tuple(f"{number}: {target.file.file.name}" for number, target in enumerate(document.targets))

        def open_as(place: Any) -> None:
            name = typed("File").strip()
            document.open_target(AsTarget(typed("Unit"), place).target(Path(name)) if name else None)

        def begin() -> None:
            search.start(*(typed("Search from here", label) for label in ("May change", "Seconds")))

        def show_pose(name: str) -> None:
            document.show_pose(poses.index(name) if name in poses else -1)

        several = len(document.opened.targets) > 1
        return [
            *([_choice("Pose", poses or (NONE,), (*poses, NONE)[document.pose], show_pose)] if several else []),
            entry("text", "File", "" if file is None else str(file.file)),
            _choice("Unit", tuple(UNITS), "m" if file is None else file.unit),
            buttons("Open", {"as given": partial(open_as, "given"), "fit": partial(open_as, "fit")}),
            folder("Placed by hand", *self._by_hand(), closed=True),
            folder(
                "Search from here",
                _choice("May change", VARIES, VARIES[0]),
                entry("number", "Seconds", 120.0, min=1.0, max=86400.0, step=10.0),
                button("Search from here", begin, disabled=search.running),
                button("Stop, keep the best", search.stop, disabled=not search.running),
                words("message", search.message),
            ),
        ]

    def _by_hand(self) -> list[Widget]:
        target = self._document.target
        shift, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        if target is not None:
            x, y, z = (round(in_mm(x), 3) for x in target.file.translation)
            shift, turn = (x, y, z), target.file.rotation or turn

        def place(_: Any) -> None:
            turned, shifted = (self._hands.typed("Target", "Placed by hand", label) for label in (_TURN, _SHIFT))
            self._document.place_target(tuple(turned), tuple(from_mm(x) for x in shifted))

        hint = "Drag it by arrows and rings in the scene"
        return [
            entry("checkbox", "Gizmo", self._hands.gizmo, self._hands.set_gizmo, hint=hint),
            entry("vector3", _SHIFT, shift, place, step=0.5),
            entry("vector3", _TURN, turn, place, step=1.0),
        ]

    # Results of searches, beside the own drawing

    def _results(self) -> list[Widget]:
        document, rows = self._document, self._document.rows()
        names = tuple(row.name for row in rows)
        said = [f"{result.name}: {result.state}" for result in document.results]
        own = rows[0] if len(document.targets) == 1 else None
        for result in document.results:
            buys = one_more_buys(result, [other for other in document.results if other is not result], own)
            said += [buys] if buys else []
        nothing = "Nothing yet: *Search from here* under *Target*. An edit of a result takes it as own drawing."

        def show(name: str) -> None:
            document.show_result(next((result for result in document.results if result.name == name), None))

        return [
            _choice("Shown", names, OWN if document.shown is None else document.shown.name, show),
            entry(
                "checkbox", "The other one beside it", document.beside, partial(document.set_option, "beside"),
                hint="Its shape, seen through",
            ),
            button("Take as own drawing", document.take, disabled=document.shown is None),
            html("table", _table(rows)),
            words("message", "\n\n".join(said) or nothing),
        ]  # fmt: skip

    # Motion: played, scrubbed through, written

    def _motion(self) -> list[Widget]:
        playing, trials, typed = (
            self._session.playing,
            tuple(self._document.trials),
            partial(self._hands.typed, "Motion"),
        )
        motion, scale, text = playing.motion, "", ""
        if motion is not None:
            beside = "" if motion.ghost(playing.frame) is None else "; orange: without the corrector"
            text = motion.in_words(playing.frame) + beside
            if motion.largest is not None:
                scale = scale_bar(max(LEAST_SCALE, motion.largest), "measured point to the shown surface")
        of_trials = [
            _choice("Trial", trials, trials[0]),
            button("Show measured and predicted", lambda: playing.trial(typed("Trial"))),
            button("Errors of all trials", self._session.trial_errors.begin),
        ] if trials else []  # fmt: skip
        given = self._document.opened.program is not None
        frames = {
            "min": 0,
            "max": max(1, len(motion.times) - 1) if motion else 1,
            "step": 1,
            "disabled": motion is None,
        }
        return [
            button("Play the rise to these pressures", playing.rise),
            *([button("Play the pressures of the command line", playing.opened)] if given else []),
            entry("text", "Pressures file", ""),
            button("Play the file", lambda: playing.file(Path(typed("Pressures file").strip()))),
            *of_trials,
            button("Play" if motion and not playing.running else "Pause", playing.toggle, disabled=motion is None),
            entry("slider", "Frame", playing.frame if motion else 0, playing.scrub, **frames),
            words("frame", text),
            html("scale", scale),
            folder(
                "For other programs",
                entry("text", "File", "motion.glb", hint=".glb, .pvd, .rrd, .csv, .html or .png"),
                button("Write the motion", lambda: playing.write(Path(typed("For other programs", "File").strip()))),
                closed=True,
            ),
            words("errors", errors_table(self._session.trial_errors.by_label)),
        ]

    # Files: saved, exported, taken again

    def _files(self) -> list[Widget]:
        files, history, typed = self._session.files, self._document.history, partial(self._hands.typed, "Files")
        state = "unsaved changes, kept in an autosave" if history.changed else "nothing unsaved"
        undo = f"; undo: {history.next_undo}" if history.next_undo else ""

        def save() -> None:
            folder = Path(typed("Folder").strip())
            self._hands.unless_lost(files.would_replace(folder), partial(files.save, folder))

        def export() -> None:
            folder = Path(typed(_TEMPLATE, "Folder").strip())
            mark = read_mark(folder)
            reason = None if mark is None else f"{folder} holds what `fabdesign {mark.made_by}` wrote"
            self._hands.unless_lost(reason, partial(files.save_template, folder))

        return [
            entry("text", "Folder", str(files.folder)),
            button("Save", save),
            button("Load from disk", files.load_again),
            words("state", f"`{self._document.opened.file}`: {state}{undo}"),
            folder(
                _TEMPLATE,
                entry("text", "Folder", str(files.template_folder)),
                button("Export template", export),
            ),
        ]


def _choice(label: str, options: Sequence[str], value: str, then: Callable[[str], None] | None = None) -> Widget:
    return entry("dropdown", label, value, then, options=tuple(options))


def _without_corner(layout: Layout, index: int) -> Layout:
    """Take off the last corner between the ends, if there is one."""
    return remove_corner(layout, index, max(1, len(layout.design.muscles[index].path) - 2))


def _table(rows: Sequence[Row]) -> str:
    """Return the table that compares the own drawing with results."""

    def millimetres(value: float | None) -> str:
        return "" if value is None else f"{in_mm(value):.2f}"

    head = "<tr><th></th><th>muscles</th><th>Chamfer, mm</th><th>surface RMS, mm</th><th>highest, kPa</th></tr>"
    lines = [
        f"<tr style='font-weight:{'bold' if row.shown else 'normal'}'><td>{escape(row.name)}</td>"
        f"<td>{row.muscles}</td><td>{millimetres(row.chamfer)}</td><td>{millimetres(row.surface_rms)}</td>"
        f"<td>{in_kpa(row.highest):.0f}</td></tr>"
        for row in rows
    ]
    style = "font-size:0.82em; margin:0.4em 0.9em; text-align:right; border-spacing:0.7em 0.2em"
    return f'<table id="studio-results" style="{style}">{head}{"".join(lines)}</table>'
