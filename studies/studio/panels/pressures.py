"""A slider for each channel, in kPa."""

from typing import Any

from fabdesign.units import from_kpa, in_kpa
from studies.studio.layout import highest
from studies.studio.panels.asking import Post, on_input, put
from studies.studio.session import Session


class PressurePanel:
    def __init__(self, gui: Any, session: Session, post: Post) -> None:
        self._gui, self._session, self._post = gui, session, post
        self._folder = gui.add_folder("Pressures")
        self._sliders: list[Any] = []
        self._ends: list[float] = []

    def show(self) -> None:
        layout = self._session.layout
        ends = highest(layout.design)
        if ends != self._ends:
            for slider in self._sliders:
                slider.remove()
            with self._folder:
                self._sliders = [self._slider(channel, end) for channel, end in enumerate(ends)]
            self._ends = ends
        for slider, pressure, end in zip(self._sliders, layout.pressures, ends, strict=True):
            put(slider, round(in_kpa(min(pressure, end)), 1))

    def _slider(self, channel: int, end: float) -> Any:
        slider = self._gui.add_slider(f"Channel {channel}, kPa", 0.0, round(in_kpa(end), 1), 1.0, 0.0)
        on_input(slider, self._post, lambda value: self._session.press(channel, from_kpa(value)))
        return slider
