"""The panel beside the scene, declared: each tab says its fields, and what a person's input does."""

from collections.abc import Sequence
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from fabdesign.clouds.target_file import AsTarget
from fabdesign.geometry.placement import UNITS
from fabdesign.output import read_mark
from fabdesign.units import in_kpa, in_mm
from studies.studio.drawings import Row, one_more_buys
from studies.studio.measured import errors_table
from studies.studio.search import VARIES
from studies.studio.session import Session
from studies.studio.widgets.declared import MM, Widget, Widgets, button, buttons, choice, entry, folder, html, words
from studies.studio.widgets.design_panels import NONE, model, muscle, pressures, program
from studies.studio.widgets.hung_view import LEAST_SCALE
from studies.studio.widgets.status import profile, scale_bar, status

OWN = "own drawing"
_SHIFT, _TURN, _TEMPLATE = "Shift, mm", "Turn, degrees", "Sewing template, 1:1"


class Panel:
    """The widgets beside the scene. typed(...): what stands in an input. gizmo: whether the target has one."""

    def __init__(self, session: Session, made: Widgets) -> None:
        self._session, self._document, self._made = session, session.document, made
        self.gizmo = False

    def widgets(self) -> list[Widget]:
        tabs = {
            "Layout": muscle(self._document),
            "Model": [html("profile", profile(self._session)), *model(self._document)],
            "Target": self._target(),
            "Results": self._results(),
            "Motion": [*program(self._session, self._made), *self._motion()],
            "Files": self._files(),
        }
        pages = [Widget("tab", name, inside=widgets) for name, widgets in tabs.items()]
        sliders = folder("Pressures", *pressures(self._document))
        return [*status(self._session), sliders, Widget("tab_group", inside=pages)]

    # Target: opened, placed by fit or by hand, and searched for from here

    def _target(self) -> list[Widget]:
        document, search, typed = self._document, self._session.search, partial(self._made.typed, "Target")
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
            *([choice("Pose", poses or (NONE,), (*poses, NONE)[document.pose], show_pose)] if several else []),
            entry("text", "File", "" if file is None else str(file.file)),
            choice("Unit", tuple(UNITS), "m" if file is None else file.unit),
            buttons("Open", {"as given": partial(open_as, "given"), "fit": partial(open_as, "fit")}),
            folder("Placed by hand", *self._by_hand(), closed=True),
            folder(
                "Search from here",
                choice("May change", VARIES, VARIES[0]),
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
            shift, turn = target.file.translation, target.file.rotation or turn

        def place(_: Any) -> None:
            turned, shifted = (self._made.typed("Target", "Placed by hand", label) for label in (_TURN, _SHIFT))
            self._document.place_target(turned, shifted)

        hint = "Drag it by arrows and rings in the scene"
        return [
            entry("checkbox", "Gizmo", self.gizmo, self._set_gizmo, hint=hint),
            entry("vector3", _SHIFT, shift, place, MM, step=0.5),
            entry("vector3", _TURN, turn, place, step=1.0),
        ]

    def _set_gizmo(self, on: bool) -> None:
        self.gizmo = on
        self._document.show()

    # Results of searches, beside the own drawing

    def _results(self) -> list[Widget]:
        document, rows = self._document, self._document.rows()
        names = tuple(row.name for row in rows)
        said = [f"{result.name}: {result.state}" for result in document.results]
        drawn = rows[0] if len(document.targets) == 1 else None
        for result in document.results:
            buys = one_more_buys(result, [other for other in document.results if other is not result], drawn)
            said += [buys] if buys else []
        nothing = "Nothing yet: *Search from here* under *Target*. An edit of a result takes it as own drawing."

        def show(name: str) -> None:
            document.show_result(next((result for result in document.results if result.name == name), None))

        return [
            choice("Shown", names, OWN if document.shown is None else document.shown.name, show),
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
            partial(self._made.typed, "Motion"),
        )
        motion, scale, text = playing.motion, "", ""
        if motion is not None:
            beside = "" if motion.ghost(playing.frame) is None else "; orange: without the corrector"
            text = motion.in_words(playing.frame) + beside
            if motion.largest is not None:
                scale = scale_bar(max(LEAST_SCALE, motion.largest), "measured point to the shown surface")
        of_trials = [
            choice("Trial", trials, trials[0]),
            button("Show measured and predicted", lambda: playing.trial(typed("Trial"))),
            button("Errors of all trials", self._session.trial_errors.begin),
        ] if trials else []  # fmt: skip
        given = self._document.opened.program is not None
        last = max(1, len(motion.times) - 1) if motion else 1
        return [
            button("Play the rise to these pressures", playing.rise),
            *([button("Play the pressures of the command line", playing.opened)] if given else []),
            entry("text", "Pressures file", ""),
            button("Play the file", lambda: playing.file(Path(typed("Pressures file").strip()))),
            *of_trials,
            button("Play" if motion and not playing.running else "Pause", playing.toggle, disabled=motion is None),
            entry(
                "slider",
                "Frame",
                playing.frame if motion else 0,
                playing.scrub,
                min=0,
                max=last,
                step=1,
                disabled=motion is None,
            ),
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
        files, history, typed = self._session.files, self._document.history, partial(self._made.typed, "Files")
        state = "unsaved changes, kept in an autosave" if history.changed else "nothing unsaved"
        undo = f"; undo: {history.next_undo}" if history.next_undo else ""

        def save() -> None:
            folder = Path(typed("Folder").strip())
            self._made.unless_lost(files.saving.replaces(folder), partial(files.save, folder))

        def export() -> None:
            folder = Path(typed(_TEMPLATE, "Folder").strip())
            mark = read_mark(folder)
            reason = None if mark is None else f"{folder} holds what `fabdesign {mark.made_by}` wrote"
            self._made.unless_lost(reason, partial(files.save_template, folder))

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
