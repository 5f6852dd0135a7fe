"""Data sheet or model file, and effects on switches with their parameters."""

from dataclasses import replace
from functools import partial
from typing import Any

from fabdesign.effects.registry import EFFECTS
from studies.studio.panels.asking import Post, on_input, put
from studies.studio.session import Session

SHEET, FILE = "data sheet", "model file"


class ModelPanel:
    def __init__(self, gui: Any, session: Session, post: Post) -> None:
        self._gui, self._session, self._post = gui, session, post
        self._base: Any = None
        if session.opened.model is not None:
            self._base = gui.add_dropdown("Values", (FILE, SHEET))
            on_input(self._base, post, lambda name: session.choose(session.choice.sheet(name == FILE)))
        self._corrector: Any = None
        if session.choice.has_corrector:
            self._corrector = gui.add_checkbox("Corrector", session.choice.corrected, hint="Exact shapes and motions")
            on_input(self._corrector, post, lambda on: session.choose(replace(session.choice, corrected=on)))
        self._switches: dict[str, Any] = {}
        self._folders: dict[str, Any] = {}
        self._inputs: dict[tuple[str, str], Any] = {}
        for name, effect in EFFECTS.items():
            if effect.site == "sensing":
                continue  # of sensors, which see no shape here
            self._folders[name] = folder = gui.add_folder(name.replace("_", " "), expand_by_default=False)
            with folder:
                self._switches[name] = gui.add_checkbox("On", name in session.choice.effect_values, hint=effect.what)
            on_input(self._switches[name], post, partial(self._switch, name))
        self.show()

    def show(self) -> None:
        choice = self._session.choice
        if self._base is not None:
            put(self._base, FILE if choice.fitted else SHEET)
        if self._corrector is not None:
            put(self._corrector, choice.corrected)
            acts = choice.model.corrector is not None or not choice.corrected
            self._corrector.hint = (
                "Exact shapes and motions" if acts else "Left out: it was trained beside other effects"
            )
        for name, switch in self._switches.items():
            put(switch, name in choice.effect_values)
        wanted = {
            (name, key) for name, values in choice.effect_values.items() for key in values if name in self._folders
        }
        for gone in self._inputs.keys() - wanted:
            self._inputs.pop(gone).remove()
        for name, key in sorted(wanted):
            if (name, key) not in self._inputs:
                self._inputs[name, key] = self._field(name, key)
            put(self._inputs[name, key], round(choice.effect_values[name][key], 6))

    def _field(self, name: str, key: str) -> Any:
        parameter = EFFECTS[name].parameters[key]
        unit = f", {parameter.unit}" if parameter.unit not in ("", "1") else ""
        with self._folders[name]:
            field = self._gui.add_number(
                f"{key.replace('_', ' ')}{unit}",
                0.0,
                min=parameter.bounds[0],
                max=parameter.bounds[1],
                hint=parameter.what,
            )
        on_input(field, self._post, lambda value: self._set(name, key, float(value)))
        return field

    def _switch(self, name: str, on: bool) -> None:
        self._session.choose(self._session.choice.switched(name, on))

    def _set(self, name: str, key: str, value: float) -> None:
        if name in self._session.choice.effect_values:
            self._session.choose(self._session.choice.with_value(name, key, value))
