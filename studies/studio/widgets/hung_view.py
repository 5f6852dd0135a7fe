"""The cloth as it hangs, with its muscles, and what is shown beside it: target, measured points, other shapes; and
below it the program under edit, a line for each channel, with knots that are dragged."""

from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.surface import face_triangles, front_triangles
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.units import in_kpa
from studies.studio.drawings import LiveShape
from studies.studio.opening import LEAST_SCALE, Comparison
from studies.studio.session import Session
from studies.studio.widgets.declared import LIFT, Node
from studies.studio.widgets.flat_view import BACK, FRONT, HUNG_TURN, Colour, Places, colour, heat, laced, lines

_OTHER, _BEFORE = (60, 90, 200), (230, 140, 40)  # of another drawing's shape; of one before a jump or a correction
_POINT = 0.0011  # m, of a cloud's point as drawn
_RAISED = 0.25  # of the thickness, that colours lie over a face, below the muscles
_PLAIN = (70, 90, 110)
_KNOT = 0.0035  # m, radius
_DARK, _GREY = (20, 20, 20), (120, 130, 142)
Shape = NDArray[np.float32]


def hung_nodes(session: Session) -> dict[str, Node]:
    """Return the shape at rest beside target and other shapes, or a motion's frame beside what was measured."""
    document, motion, shape = session.document, session.playing.motion, session.shapes.shown
    nodes, frame = _frame(document.layout.design), session.playing.frame
    if motion is not None:
        nodes |= _cloth(motion.points[frame], document.layout.design)
        nodes |= _beside("simulated", motion.ghost(frame), _BEFORE)
        cloud, distances = motion.cloud(frame), motion.distances(frame)
        if cloud is not None and distances is not None:
            nodes |= _cloud("measured", cloud, heat(distances, motion.largest or LEAST_SCALE))
        return nodes
    if shape is not None:
        nodes |= _at_rest(shape) | _beside("before", session.shapes.before, _BEFORE)
    if document.other is not None and document.other.live is not None:
        nodes |= _beside("other", document.other.live.points, _OTHER)
    if document.target is not None:
        points = document.target.points
        nodes |= _cloud("target", points, np.tile(np.array(_PLAIN, np.uint8), (len(points), 1)))
    if shape is not None and document.seen.comparison is not None:
        nodes["/hung/distances"] = _distances(shape, document.seen.comparison)
    return nodes


def _frame(design: Design) -> dict[str, Node]:
    places = Places.of(design.fabric)
    bar = np.array([(-0.54 * places.width, 0.001, 0.0), (0.54 * places.width, 0.001, 0.0)])
    look = {"thickness_units": "world", "visible": design.fabric.hung == "top"}
    title = {"text": "as it hangs", "anchor": "bottom-center", "position": (0.0, 0.06 * places.height, 0.0)}
    where = {"position": places.hung_origin, "wxyz": tuple(HUNG_TURN.as_quat(scalar_first=True).tolist())}
    return {
        "/hung": Node("frame", {"show_axes": False, **where}),
        "/hung/title": Node("label", title),
        "/hung/bar": lines(bar, shade=(60, 60, 60), thickness=0.015 * places.width, **look),
    }


@lru_cache(maxsize=2)
def _at_rest(shape: LiveShape) -> dict[str, Node]:
    return _cloth(shape.points, shape.layout.design)


def _cloth(points: Shape, design: Design) -> dict[str, Node]:
    """Return the cloth in two colours, front and back, and its muscles."""
    (front, back), triangles = points.reshape(2, -1, 3), _triangles(len(points))
    nodes = {}
    for side, vertices, faces, shade in (("front", front, triangles, FRONT), ("back", back, triangles[:, ::-1], BACK)):
        face = {"vertices": vertices, "faces": faces, "color": shade, "side": "front"}
        nodes[f"/hung/{side}"] = Node("mesh_simple", face)
    for i, muscle in enumerate(design.muscles):
        line, width = laced(points, muscle, design.fabric), design.muscle_types[muscle.type].outer_diameter
        shade = colour(muscle.channel)
        nodes[f"/hung/muscle_{i}"] = lines(line, shade=shade, thickness=width, thickness_units="world")
    return nodes


def _beside(name: str, points: Shape | None, shade: Colour) -> dict[str, Node]:
    """Return another shape, seen through: the one before a jump, one without the corrector, or another drawing's."""
    if points is None:
        return {}
    look = {"color": shade, "opacity": 0.3, "side": "double", "cast_shadow": False}
    face = {"vertices": points[: len(points) // 2], "faces": _triangles(len(points)), **look}
    return {f"/hung/{name}": Node("mesh_simple", face)}


@lru_cache(maxsize=4)
def _triangles(points: int) -> NDArray[np.uint32]:
    side = round((points // 2) ** 0.5)
    return front_triangles(side, side).astype(np.uint32)


def _cloud(name: str, points: Array, colours: NDArray[np.uint8]) -> dict[str, Node]:
    look = {"point_size": _POINT, "point_shape": "circle", "precision": "float32", "point_shading": "flat"}
    return {f"/hung/{name}": Node("point_cloud", {"points": points.astype(np.float32), "colors": colours, **look})}


@lru_cache(maxsize=4)
def _distances(shape: LiveShape, comparison: Comparison) -> Node:
    """Return colours over the two of the cloth: each point's distance. The faces stay below, so that there is a surface
    while a browser takes the colours apart, and where it does not get them."""
    import trimesh

    side = round((len(shape.points) // 2) ** 0.5)
    front, back = shape.points.reshape(2, -1, 3).astype(np.float64)
    raised = np.concatenate([front + _RAISED * (front - back), back + _RAISED * (back - front)])
    opaque = np.full((len(raised), 1), 255, np.uint8)
    colours = np.concatenate([heat(comparison.of_cloth, comparison.largest), opaque], axis=1)
    mesh = trimesh.Trimesh(raised, face_triangles(side, side), vertex_colors=colours, process=False)
    return Node("mesh_trimesh", {"mesh": mesh})


def program_nodes(session: Session) -> dict[str, Node]:
    """Return the plot of the program under edit, with what a hand does to it; nothing where there is none."""
    edit, playing, document = session.program, session.playing, session.document
    if edit is None:
        return {}
    pressures, cycle, highest = edit.pressures, edit.moving.regulator.cycle, float(edit.moving.regulator.highest.max())
    end = len(pressures) * cycle
    (left, below), (width, height) = Places.of(document.layout.design.fabric).plot

    def places(times: Any, values: Any) -> Array:
        """Return (n, 3) m of times [s] and pressures [Pa]."""
        x, y = left + width * np.asarray(times) / end, below + height * np.asarray(values) / highest
        return np.stack([x, y, np.full_like(x, LIFT)], axis=1)

    def label(text: str, time: float, pressure: float, anchor: str) -> Node:
        return Node("label", {"text": text, "position": tuple(places([time], [pressure])[0]), "anchor": anchor})

    def drag(_begin: Array, at: Array, _last: bool) -> None:
        edit.put(highest * (float(at[1]) - below) / height)

    nodes = {
        "/program/axes": lines(places([0.0, 0.0, end], [highest, 0.0, 0.0]), shade=_GREY),
        "/program/most": label(f"{in_kpa(highest):.0f} kPa", 0.0, highest, "center-right"),
        "/program/end": label(f"{end:.2f} s", end, 0.0, "top-center"),
        "/program/title": label(f"program, channel {edit.channel}", end / 2, highest, "bottom-center"),
    }
    if playing.motion is not None and playing.motion.off is not None:
        now = places(np.full(2, playing.motion.times[playing.frame]), [0.0, highest])
        nodes["/program/now"] = lines(now, shade=_GREY)
    steps = cycle * np.repeat(np.arange(len(pressures) + 1), 2)[1:-1]
    for channel, values in enumerate(np.repeat(pressures, 2, axis=0).T):
        thickness = 3.0 if channel == edit.channel else 1.0
        nodes[f"/program/line_{channel}"] = lines(places(steps, values), shade=colour(channel), thickness=thickness)
    for k, at in enumerate(places(cycle * edit.knots, pressures[edit.knots, edit.channel])):
        shade, larger = (_DARK, 1.3) if k == edit.knot else (colour(edit.channel), 1.0)
        ball = {"radius": larger * _KNOT, "color": shade, "position": tuple(at), "subdivisions": 2}
        nodes[f"/program/knot_{k}"] = Node("icosphere", ball, partial(edit.select, edit.channel, k), drag)
    return nodes
