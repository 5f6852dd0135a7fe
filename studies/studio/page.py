"""The page: scene and panel put together. It shows a session and lets hands at it."""

from collections.abc import Callable
from typing import Any

import numpy as np

from studies.studio.flat_view import FlatView
from studies.studio.hung_view import HungView
from studies.studio.live import LiveShape
from studies.studio.panels.files import FilePanel
from studies.studio.panels.model import ModelPanel
from studies.studio.panels.motion import MotionPanel
from studies.studio.panels.muscles import MusclePanel
from studies.studio.panels.pressures import PressurePanel
from studies.studio.panels.profile import ProfilePanel
from studies.studio.panels.results import ResultPanel
from studies.studio.panels.status import LEAST_SCALE, StatusPanel
from studies.studio.panels.target import TargetPanel
from studies.studio.scene import Places
from studies.studio.session import Session

VIEW, ASPECT = 0.6, 1.3  # rad that is seen from top to bottom; width over height of what the panel leaves, mostly
_FILLED = 0.97  # of the picture, by what is to be in view
_OTHER = (60, 90, 200)  # of another drawing's shape


def eye_of(places: Places, aspect: float = ASPECT) -> tuple[float, float, float]:
    """m, where one looks from at first, towards the origin: all is in view, a little from the right and above. aspect:
    width over height of the picture."""
    back = np.array([0.12, 0.1, 1.0]) / np.linalg.norm([0.12, 0.1, 1.0])
    right = np.cross([0, 1, 0], back) / np.linalg.norm(np.cross([0, 1, 0], back))
    points, high = places.outline, _FILLED * np.tan(VIEW / 2)
    across, up = np.abs(points @ right) / aspect, np.abs(points @ np.cross(back, right))
    x, y, z = back * (np.maximum(across, up) / high + points @ back).max()
    return float(x), float(y), float(z)


class Page:
    """Implements session.SessionView on a viser server. post: runs a function on the session's thread."""

    def __init__(self, server: Any, session: Session, post: Callable[[Callable[[], None]], None]) -> None:
        self._server, self._session, self._post = server, session, post
        gui = server.gui
        self._arrange(server)
        self._flat, self._hung = FlatView(server.scene, session, post), HungView(server.scene)
        self._gizmo: Any = None
        self._status = StatusPanel(gui, session)
        self._pressures = PressurePanel(gui, session, post)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Layout"):
            self._muscles = MusclePanel(gui, session, post)
        with tabs.add_tab("Model"):
            self._profile = ProfilePanel(gui, session)
            self._model = ModelPanel(gui, session, post)
        with tabs.add_tab("Target"):
            self._target = TargetPanel(gui, session, post, self._show_gizmo)
        with tabs.add_tab("Results"):
            self._results = ResultPanel(gui, session, post)
        with tabs.add_tab("Motion"):
            self._motion = MotionPanel(gui, session, post)
        with tabs.add_tab("Files"):
            self._files = FilePanel(gui, session, post)
        for label, key, then in (("Undo", "Z", session.undo), ("Redo", "Y", session.redo)):
            command = gui.add_command(label, hotkey=key, modifier="cmd/ctrl")
            command.on_trigger(lambda _, then=then: post(then))

    def _arrange(self, server: Any) -> None:
        places = Places.of(self._session.layout.design.fabric)
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        server.gui.set_panel_label("fabdesign studio")
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(400)
        server.scene.set_up_direction("+y")
        server.scene.configure_default_lights(cast_shadow=False)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.initial_camera.position = eye_of(places)
        server.initial_camera.up = (0.0, 1.0, 0.0)
        server.initial_camera.fov = VIEW
        server.initial_camera.near = 0.005
        server.on_client_connect(self._fit_view)

    def _fit_view(self, client: Any) -> None:
        """Keep all in a tab's view, whatever its window, until a hand turns it; *Reset View* begins anew."""
        first = eye = eye_of(Places.of(self._session.layout.design.fabric))

        def fit(camera: Any) -> None:
            nonlocal eye
            if not camera.image_height or not any(np.allclose(camera.position, at, atol=1e-4) for at in (first, eye)):
                return
            eye = eye_of(Places.of(self._session.layout.design.fabric), camera.image_width / camera.image_height)
            if not np.allclose(camera.position, eye, atol=1e-4):
                camera.position, camera.look_at = eye, (0.0, 0.0, 0.0)

        client.camera.on_update(fit)
        fit(client.camera)

    # what a session asks of a view

    def show_layout(self) -> None:
        session = self._session
        with self._server.atomic():
            broken = {i for line in session.broken() for i in line.muscles}
            self._flat.draw(
                session.layout.design, selected=session.selected, broken=broken, row_distance=session.row_distance
            )
            other = session.drawings.other()
            self._flat.draw_other(None if other is None else other[0].design)
            self._status.show_limits()
            self._pressures.show()
            self._muscles.show()
            self._model.show()
            self._files.show()
            self._target.show()
            if session.playing.motion is None and not self._motion.shows(None):
                self._motion.begin()
                self._hung.draw_cloud("measured", None)
                self._hung.draw_beside("simulated", None)

    def show_shape(self, shape: LiveShape) -> None:
        if self._session.playing.motion is not None:
            return  # a motion is looked at
        with self._server.atomic():
            self._hung.draw(shape.points, shape.layout.design)
            if shape.jump is not None or self._session.document.in_gesture:
                self._hung.draw_beside("before", shape.before)
            self._hung.draw_beside("simulated", None)
            self._status.show_shape()
            self._profile.show()

    def show_comparison(self) -> None:
        session, shape = self._session, self._session.shapes.shown
        if session.playing.motion is not None:
            return
        with self._server.atomic():
            other = session.drawings.other()
            beside = None if other is None or other[1].shape is None else other[1].shape.points
            self._hung.draw_beside("other", beside, _OTHER)
            target, comparison = session.targets.shown, session.drawings.comparison
            if target is None:
                self._hung.draw_cloud("target", None)
            elif comparison is None or shape is None:
                self._hung.draw_cloud("target", target.points)
            else:
                largest = max(LEAST_SCALE, float(np.percentile(comparison.of_cloth, 98)))
                self._hung.draw_distances(shape.points, comparison.of_cloth, largest)
                self._hung.draw_cloud("target", target.points)
                self._status.show_scale(largest)

    def show_motion(self) -> None:
        """A motion has come, or another frame of it is to be seen."""
        motion = self._session.playing.motion
        if motion is None:
            return
        if not self._motion.shows(motion):
            self._motion.begin()
            for name in ("before", "other"):
                self._hung.draw_beside(name, None)
        self._draw_frame()

    def _draw_frame(self) -> None:
        motion = self._session.playing.motion
        if motion is None:
            return
        frame = self._motion.frame
        with self._server.atomic():
            self._hung.draw(motion.points[frame], self._session.layout.design)
            cloud = motion.cloud(frame)
            self._hung.draw_cloud("target", None)
            largest = max(LEAST_SCALE, motion.largest or 0.0)
            self._hung.draw_cloud("measured", cloud, motion.distances(frame), largest)
            self._hung.draw_beside("simulated", motion.ghost(frame))
            self._motion.show()

    def show_results(self) -> None:
        self._results.show()

    def show_band(self) -> None:
        self._profile.show()

    def show_trial_errors(self) -> None:
        self._motion.show_errors()

    def show_search(self, message: str, *, running: bool) -> None:
        self._target.show_search(message, running=running)

    def tell(self, text: str, *, bad: bool = False) -> None:
        self._status.tell(text, bad=bad)

    # what goes on by itself

    def advance(self, seconds: float) -> None:
        """Play on for so long."""
        if self._motion.advance(seconds):
            self._draw_frame()

    def _show_gizmo(self, on: bool) -> None:
        """A gizmo that moves the target, at its middle, or none."""
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        target = self._session.targets.shown
        if not on or target is None:
            return
        import viser.transforms as transforms

        file = target.file
        angles = np.radians(file.rotation or (0.0, 0.0, 0.0))
        self._gizmo = gizmo = self._server.scene.add_transform_controls(
            "/hung/gizmo", scale=0.06, position=file.translation, wxyz=transforms.SO3.from_rpy_radians(*angles).wxyz
        )

        def moved(event: Any) -> None:
            if event.phase != "end":
                return
            turn = np.degrees(transforms.SO3(np.array(gizmo.wxyz)).as_rpy_radians())
            rotation, translation = tuple(map(float, turn)), tuple(map(float, gizmo.position))
            self._post(lambda: self._target.place(rotation, translation))

        gizmo.on_update(moved)
