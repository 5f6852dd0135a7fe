"""The page: scene and panel put together on a viser server, drawn anew from the session whenever something changes; and
the queue through which its threads reach the session's."""

import contextlib
import queue
import time
import traceback
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from fabdesign.errors import InputError
from studies.studio.opening import Opened
from studies.studio.session import Session
from studies.studio.widgets.declared import Node, SceneNodes, Widgets
from studies.studio.widgets.flat_view import VIEW, Places, eye_of, flat_nodes
from studies.studio.widgets.hung_view import hung_nodes, program_nodes
from studies.studio.widgets.panels import panel

_BEAT = 0.02  # s between looks at what is due
_SHORT = 0.002  # s, while an answer of the simulator is awaited


class Page:
    """Shows a session and lets hands at it. nodes: the scene's. widgets: what stands beside it."""

    def __init__(self, server: Any, opened: Opened, worker: Any) -> None:
        self._due: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._server, self._worker, self.post = server, worker, self._due.put
        self.session = Session(opened, worker)
        self.nodes, self.widgets = SceneNodes(server.scene, self.post), Widgets(server.gui, self.post)
        self._stale = False  # whether it shows what no longer holds
        self._arrange(server)
        for label, key, by in (("Undo", "Z", -1), ("Redo", "Y", 1)):
            command = server.gui.add_command(label, hotkey=key, modifier="cmd/ctrl")
            command.on_trigger(lambda _, by=by: self.post(partial(self.session.document.step, by)))

    def begin(self) -> None:
        self._do(partial(self.session.begin, partial(setattr, self, "_stale", True)))

    def run(self, until: Callable[[], bool] = lambda: False) -> None:
        self.begin()
        last, alive = time.monotonic(), True
        while not until():
            self.turn()
            now = time.monotonic()
            self.session.playing.advance(now - last)
            last = now
            if alive and not self._worker.alive:
                alive = False
                self.session.document.tell("The simulator has ended; save, and start the studio again.", bad=True)

    def turn(self) -> None:
        """Do what hands ask, all that has come, or after a beat nothing; then what is due; draw what changed."""
        with contextlib.suppress(queue.Empty):
            ask = self._due.get(timeout=_SHORT if self.session.shapes.waiting else _BEAT)
            while True:
                self._do(ask)
                ask = self._due.get_nowait()
        self._do(self.session.tick)
        if self._stale:
            self._do(self._show)
            self._stale = False  # also where that failed: it would fail again

    def _do(self, ask: Callable[[], None]) -> None:
        """Do one thing, and tell bad input; an error in it must not take the layout along."""
        tell = self.session.document.tell
        try:
            ask()
        except InputError as error:
            tell(str(error), bad=True)
        except Exception as error:
            traceback.print_exc()
            tell(f"an error of the program: {type(error).__name__}: {error}", bad=True)

    def _show(self) -> None:
        """Draw all that the session holds."""
        with self._server.atomic():
            hung, program = hung_nodes(self.session), program_nodes(self.session)
            self.nodes.show(flat_nodes(self.session.document) | hung | self._gizmo_node() | program)
            self.widgets.show(panel(self.session, self.widgets.unless_lost))

    def _arrange(self, server: Any) -> None:
        server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
        server.gui.set_panel_label("fabdesign studio")
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(400)
        server.scene.set_up_direction("+y")
        server.scene.configure_default_lights(cast_shadow=False)
        camera = server.initial_camera
        camera.look_at, camera.position, camera.up = (0.0, 0.0, 0.0), self._eye(), (0.0, 1.0, 0.0)
        camera.fov, camera.near = VIEW, 0.005
        server.on_client_connect(self._fit_view)

    def _eye(self, *aspect: float) -> tuple[float, float, float]:
        return eye_of(Places.of(self.session.document.layout.design.fabric), *aspect)

    def _fit_view(self, client: Any) -> None:
        """Keep all in a tab's view, whatever its window, until a hand turns it; *Reset View* begins anew."""
        first = eye = self._eye()

        def fit(camera: Any) -> None:
            nonlocal eye
            if not camera.image_height or not any(np.allclose(camera.position, at, atol=1e-4) for at in (first, eye)):
                return
            eye = self._eye(camera.image_width / camera.image_height)
            if not np.allclose(camera.position, eye, atol=1e-4):
                camera.position, camera.look_at = eye, (0.0, 0.0, 0.0)

        client.camera.on_update(fit)
        fit(client.camera)

    def _gizmo_node(self) -> dict[str, Node]:
        """Return a gizmo that moves the target, at its middle, where one is asked for."""
        document = self.session.document
        if not document.gizmo or document.target is None:
            return {}
        from viser.transforms import SO3

        def moved(turn: tuple[float, ...], place: tuple[float, ...]) -> None:
            document.place_target(tuple(map(float, np.degrees(SO3(np.array(turn)).as_rpy_radians()))), place)

        file = document.target.file
        turn = SO3.from_rpy_radians(*np.radians(file.rotation or (0.0, 0.0, 0.0))).wxyz
        given = {"scale": 0.06, "position": file.translation, "wxyz": tuple(turn.tolist())}
        return {"/hung/gizmo": Node("transform_controls", given, moved=moved)}
