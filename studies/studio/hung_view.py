"""The cloth as it hangs, with its muscles, and what is shown beside it: target, measured points, a shape before."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.design import Design
from fabdesign.surface import face_triangles
from studies.studio.scene import BACK, FRONT, Places, colour, heat, laced

Points = NDArray[np.floating[Any]]
_POINT = 0.0011  # m, of a cloud's point as drawn
_RAISED = 0.25  # of the thickness, that colours lie over a face, below the muscles
_PLAIN = (70, 90, 110)


class HungView:
    """Draws shapes (2 n^2, 3) m under one frame of the scene."""

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._root = scene.add_frame("/hung", show_axes=False)
        self._title = scene.add_label("/hung/title", "as it hangs", anchor="bottom-center")
        self._faces: list[Any] = []
        self._muscles: list[Any] = []
        self._coloured: Any = None
        self._beside: dict[str, Any] = {}
        self._clouds: dict[str, Any] = {}
        self._shown: dict[str, tuple[Any, Any]] = {}  # what each cloud was drawn from
        self._edge: Any = None

    def draw(self, points: NDArray[np.float32], design: Design) -> None:
        """The cloth in two colours, front and back, and its muscles."""
        self._place(design)
        self._drop_colours()
        half, side = len(points) // 2, round((len(points) // 2) ** 0.5)
        if not self._faces or len(self._faces[0].vertices) != half:
            triangles = face_triangles(side, side)[: 2 * (side - 1) ** 2].astype(np.uint32)
            self._faces = [
                self._scene.add_mesh_simple("/hung/front", points[:half], triangles, color=FRONT, side="front"),
                self._scene.add_mesh_simple("/hung/back", points[half:], triangles[:, ::-1], color=BACK, side="front"),
            ]
        for face, part in zip(self._faces, (points[:half], points[half:]), strict=True):
            face.vertices = part
        self._draw_muscles(points, design)

    def _place(self, design: Design) -> None:
        places = Places.of(design.fabric)
        self._root.position, self._root.wxyz = places.hung_origin, places.hung_turn
        self._title.position = (0.0, 0.06 * places.height, 0.0)
        if self._edge is None:
            half = places.width / 2
            bar = np.array([[(-half * 1.08, 0.001, 0.0), (half * 1.08, 0.001, 0.0)]])
            self._edge = self._scene.add_line_segments(
                "/hung/bar", bar, (60, 60, 60), thickness=0.003 * places.width / 0.2
            )
        self._edge.visible = design.fabric.hung == "top"

    def _draw_muscles(self, points: NDArray[np.float32], design: Design) -> None:
        for gone in self._muscles[len(design.muscles) :]:
            gone.remove()
        del self._muscles[len(design.muscles) :]
        for i, muscle in enumerate(design.muscles):
            line = laced(points, muscle, design.fabric)
            segments = np.stack([line[:-1], line[1:]], axis=1).astype(np.float32)
            width = design.muscle_types[muscle.type].outer_diameter
            if i == len(self._muscles):
                made = self._scene.add_line_segments(
                    f"/hung/muscle_{i}", segments, colour(muscle.channel), thickness=width
                )
                self._muscles.append(made)
            self._muscles[i].points = segments
            self._muscles[i].colors = np.array(colour(muscle.channel), dtype=np.uint8)

    def draw_distances(self, points: NDArray[np.float32], distances: Points, largest: float) -> None:
        """Over the two colours: each point's distance [m] as colour, up to `largest`. The faces stay below, so that
        there is a surface while a browser takes the colours apart, and where it does not get them."""
        import trimesh

        side = round((len(points) // 2) ** 0.5)
        front, back = points.reshape(2, -1, 3).astype(np.float64)
        raised = np.concatenate([front + _RAISED * (front - back), back + _RAISED * (back - front)])
        colours = np.concatenate(
            [heat(np.asarray(distances, dtype=float), largest), np.full((len(points), 1), 255, np.uint8)], axis=1
        )
        mesh = trimesh.Trimesh(raised, face_triangles(side, side), vertex_colors=colours, process=False)
        self._coloured = self._scene.add_mesh_trimesh("/hung/distances", mesh)

    def _drop_colours(self) -> None:
        if self._coloured is not None:
            self._coloured.remove()
            self._coloured = None

    def draw_cloud(
        self, name: str, points: Points | None, distances: Points | None = None, largest: float = 0.0
    ) -> None:
        """A target or what was measured, by its `name`; None takes it away. With distances [m]: as colour."""
        shown = (points, distances)
        if self._shown.get(name) is not None and all(a is b for a, b in zip(self._shown[name], shown, strict=True)):
            return
        self._shown[name] = shown
        old = self._clouds.pop(name, None)
        if old is not None:
            old.remove()
        if points is None:
            return
        colours = np.tile(np.array(_PLAIN, np.uint8), (len(points), 1))
        if distances is not None:
            colours = heat(np.asarray(distances, dtype=float), largest)
        self._clouds[name] = self._scene.add_point_cloud(
            f"/hung/{name}", np.asarray(points, np.float32), colours, point_size=_POINT, point_shape="circle",
            precision="float32", point_shading="flat",
        )  # fmt: skip

    def draw_beside(
        self, name: str, points: NDArray[np.float32] | None, shade: tuple[int, int, int] = (230, 140, 40)
    ) -> None:
        """Another shape, seen through: the one before a jump, one without the corrector, or another drawing's. None
        takes it away."""
        drawn = self._beside.get(name)
        if points is None:
            if drawn is not None:
                self._beside.pop(name).remove()
            return
        half, side = len(points) // 2, round((len(points) // 2) ** 0.5)
        if drawn is not None and len(drawn.vertices) == half:
            drawn.vertices = points[:half]
            return
        triangles = face_triangles(side, side)[: 2 * (side - 1) ** 2].astype(np.uint32)
        self._beside[name] = self._scene.add_mesh_simple(
            f"/hung/{name}", points[:half], triangles, color=shade, opacity=0.3, side="double", cast_shadow=False
        )
