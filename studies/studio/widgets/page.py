"""The page: scene and panel put together on a viser server, drawn anew from the session whenever something changes."""

from typing import Any

import numpy as np

from studies.studio.session import Session
from studies.studio.widgets.declared import Node, Post, SceneNodes, Widgets
from studies.studio.widgets.flat_view import VIEW, Places, eye_of, flat_nodes
from studies.studio.widgets.hung_view import hung_nodes, program_nodes
from studies.studio.widgets.panels import panel


class Page:
    """Shows a session and lets hands at it. post: runs a function on the session's thread. nodes: the scene's. widgets:
    what stands beside it."""

    def __init__(self, server: Any, session: Session, post: Post) -> None:
        self._server, self._session = server, session
        self._arrange(server)
        self.nodes, self.widgets = SceneNodes(server.scene, post), Widgets(server.gui, post)
        document = session.document
        for label, key, then in (("Undo", "Z", document.undo), ("Redo", "Y", document.redo)):
            command = server.gui.add_command(label, hotkey=key, modifier="cmd/ctrl")
            command.on_trigger(lambda _, then=then: post(then))

    def show(self) -> None:
        """Draw all that the session holds."""
        with self._server.atomic():
            hung, program = hung_nodes(self._session), program_nodes(self._session)
            self.nodes.show(flat_nodes(self._session.document) | hung | self._gizmo_node() | program)
            self.widgets.show(panel(self._session, self.widgets))

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
        return eye_of(Places.of(self._session.document.layout.design.fabric), *aspect)

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
        target = self._session.document.target
        if not self._session.document.gizmo or target is None:
            return {}
        import viser.transforms as transforms

        angles = np.radians(target.file.rotation or (0.0, 0.0, 0.0))

        def moved(turn: tuple[float, ...], place: tuple[float, ...]) -> None:
            turned = np.degrees(transforms.SO3(np.array(turn)).as_rpy_radians())
            self._session.document.place_target(tuple(map(float, turned)), place)

        turn = tuple(transforms.SO3.from_rpy_radians(*angles).wxyz.tolist())
        given = {"scale": 0.06, "position": target.file.translation, "wxyz": turn}
        return {"/hung/gizmo": Node("transform_controls", given, moved=moved)}
