"""What searches found, beside the own drawing: a table, and which of them is shown."""

from html import escape
from typing import Any

from fabdesign.units import in_kpa, in_mm
from studies.studio.panels.asking import Post, markdown, on_click, on_input, put
from studies.studio.results import one_more_buys
from studies.studio.session import Session

OWN = "own drawing"


class ResultPanel:
    def __init__(self, gui: Any, session: Session, post: Post) -> None:
        self._session, drawings = session, session.drawings
        self._shown = gui.add_dropdown("Shown", (OWN,))
        on_input(self._shown, post, self._choose)
        self._beside = gui.add_checkbox(
            "The other one beside it", session.drawings.beside, hint="Its shape, seen through"
        )
        on_input(self._beside, post, drawings.set_beside)
        self._take = gui.add_button("Take as own drawing", disabled=True)
        on_click(self._take, post, drawings.take)
        self._table = gui.add_html("")
        self._text = gui.add_markdown("")
        self.show()

    def show(self) -> None:
        session = self._session
        rows, results = session.drawings.rows(), session.drawings.results
        names = tuple(row.name for row in rows)
        if self._shown.options != names:
            self._shown.options = names
        put(self._shown, OWN if session.drawings.shown is None else session.drawings.shown.name)
        self._take.disabled = session.drawings.shown is None
        head = "<tr><th></th><th>muscles</th><th>Chamfer, mm</th><th>surface RMS, mm</th><th>highest, kPa</th></tr>"
        lines = [
            f"<tr style='font-weight:{'bold' if row.shown else 'normal'}'><td>{escape(row.name)}</td>"
            f"<td>{row.muscles}</td><td>{_millimetres(row.chamfer)}</td><td>{_millimetres(row.surface_rms)}</td>"
            f"<td>{in_kpa(row.highest):.0f}</td></tr>"
            for row in rows
        ]
        style = "font-size:0.82em; margin:0.4em 0.9em; text-align:right; border-spacing:0.7em 0.2em"
        self._table.content = f'<table id="studio-results" style="{style}">{head}{"".join(lines)}</table>'
        said = [f"{result.name}: {result.state}" for result in results]
        own = rows[0] if len(session.targets.all) == 1 else None
        bought = [one_more_buys(r, [o for o in results if o is not r], own) for r in results]
        self._text.content = markdown("\n\n".join([*said, *(line for line in bought if line)])) or (
            "Nothing yet: *Search from here* under *Target*. An edit of a result takes it as own drawing."
        )

    def _choose(self, name: str) -> None:
        session = self._session
        session.drawings.show(next((result for result in session.drawings.results if result.name == name), None))


def _millimetres(value: float | None) -> str:
    return "" if value is None else f"{in_mm(value):.2f}"
