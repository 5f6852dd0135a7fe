"""Files that other programs open: a series of VTK files for ParaView, with strains of the cloth, contractions and
tensions of the muscles; and a recording that the Rerun viewer plays."""

from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from fabdesign.geometry.shape import LacedMuscles, Shape, strains
from studies.view.items import Item, timeline
from studies.view.shapes import CLOUD, RGB, parts_of, vertex_normals, vertices_of

if TYPE_CHECKING:
    import meshio


def save_series(items: Sequence[Item], path: Path) -> None:
    """Write `path` (.pvd) and beside it STEM_PART_0000.vtu, ..., a file a frame and part. Coordinates are those of the
    files [m]: panels lie over each other, each a part of its own."""
    collection = ElementTree.Element("Collection")
    several = len(items) > 1
    numbers = count()

    def add(name: str, item: Item, meshes: "list[meshio.Mesh]") -> None:
        files = [f"{path.stem}_{name}_{k:04d}.vtu" for k in range(len(meshes))]
        for file, mesh in zip(files, meshes, strict=True):
            mesh.write(path.with_name(file), file_format="vtu")
        part = str(next(numbers))
        for time in timeline(items):
            entry = {"timestep": f"{time:.9g}", "group": item.title, "part": part, "name": name}
            ElementTree.SubElement(collection, "DataSet", entry | {"file": files[item.nearest(time)]})

    for number, item in enumerate(items):
        before = f"{number}_" if several else ""
        kind = "cloth" if item.is_cloth else "cloud" if item.triangles is None else "mesh"
        add(f"{before}{kind}", item, [_shape(item, k) for k in range(len(item.times))])
        if item.muscles is not None and len(item.muscles.sides):
            add(f"{before}muscles", item, [_muscles(item.muscles, k) for k in range(len(item.times))])
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1", byte_order="LittleEndian")
    root.append(collection)
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)


def _shape(item: Item, frame: int) -> "meshio.Mesh":
    import meshio

    points = np.asarray(item.frames[frame], np.float32)
    if item.triangles is None:
        return meshio.Mesh(points, [("vertex", np.arange(len(points))[:, None])])
    data = {}
    if item.is_cloth:
        data["face"] = np.repeat(np.array([1, -1], np.int8), len(points) // 2)
        if item.size is not None:
            names = ("strain_across", "strain_down", "shear_rad")
            strain = strains(Shape.of(points).middle, item.size)
            data |= {name: np.tile(s.ravel(), 2).astype(np.float32) for name, s in zip(names, strain, strict=True)}
    return meshio.Mesh(points, [("triangle", np.asarray(item.triangles))], point_data=data)


def _muscles(muscles: LacedMuscles, frame: int) -> "meshio.Mesh":
    """Return lines between fixed points; `radius` is there for ParaView's filter Tube."""
    import meshio

    data = {"muscle": [muscles.owners], "side": [muscles.sides[muscles.owners]]}
    data |= {name: [np.asarray(values[frame], np.float32)] for name, values in _states(muscles).items()}
    radius = np.repeat(muscles.diameters / 2, np.diff(muscles.begins)).astype(np.float32)
    return meshio.Mesh(
        muscles.points[frame], [("line", muscles.intervals)], point_data={"radius": radius}, cell_data=data
    )


def _states(muscles: LacedMuscles) -> dict[str, NDArray[np.float32]]:
    """Return what a simulator gave of the muscles' intervals: contraction, and tension [N]."""
    states = {"contraction": muscles.contraction, "tension_N": muscles.tension}
    return {name: values for name, values in states.items() if values is not None}


def save_recording(items: Sequence[Item], path: Path) -> None:
    """Write every panel as an entity PANEL_NUMBER/PART in metres, y upwards, on the timeline `time` in s after rest;
    muscles with contraction and tension [N] of their intervals as scalars' means."""
    import rerun

    recording = rerun.RecordingStream("fabdesign", recording_id=path.stem)
    recording.save(str(path))
    recording.log("/", rerun.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    for number, item in enumerate(items):
        name = f"{number} {item.title}"
        vertices, parts = vertices_of(item), parts_of(item)
        for k, time in enumerate(item.times):
            recording.set_time("time", duration=float(time))
            if not parts:
                recording.log([name, "cloud"], rerun.Points3D(item.frames[k], colors=_bytes(CLOUD), radii=0.0005))
            for part in parts:
                used, corners = np.unique(part.triangles, return_inverse=True)
                nodes, triangles = vertices[k][used], corners.reshape(-1, 3)
                recording.log(
                    [name, part.name],
                    rerun.Mesh3D(
                        vertex_positions=nodes,
                        triangle_indices=triangles,
                        vertex_normals=vertex_normals(nodes, triangles),
                        albedo_factor=_bytes(part.colour),
                    ),
                )
            if (muscles := item.muscles) is not None:
                for what, values in _states(muscles).items():
                    for i in range(len(muscles.sides)):
                        mean = float(values[k][muscles.owners == i].mean())
                        recording.log([name, what, f"muscle {i}"], rerun.Scalars(mean))
    recording.flush()
    recording.disconnect()


def _bytes(colour: RGB) -> list[int]:
    return [round(255 * share) for share in colour]
