"""A series of VTK files for ParaView: the cloth with its strains, the muscles with contraction and tension."""

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np

from fabdesign.geometry.shape import LacedMuscles, Shape, strains
from studies.view.items import Item, timeline


def save_series(items: Sequence[Item], path: Path) -> None:
    """Write `path` (.pvd) and beside it STEM_PART_0000.vtu, ..., a file a frame and part. Coordinates are those of the
    files [m]: panels lie over each other, each a part of its own."""
    collection = ElementTree.Element("Collection")
    several = len(items) > 1
    numbers = {"next": 0}

    def add(name: str, item: Item, meshes: list[meshio.Mesh]) -> None:
        files = [f"{path.stem}_{name}_{k:04d}.vtu" for k in range(len(meshes))]
        for file, mesh in zip(files, meshes, strict=True):
            mesh.write(path.with_name(file), file_format="vtu")
        for time in timeline(items):
            entry = {"timestep": f"{time:.9g}", "group": item.title, "part": str(numbers["next"]), "name": name}
            ElementTree.SubElement(collection, "DataSet", entry | {"file": files[item.nearest(time)]})
        numbers["next"] += 1

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


def _shape(item: Item, frame: int) -> meshio.Mesh:
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


def _muscles(muscles: LacedMuscles, frame: int) -> meshio.Mesh:
    """Return lines between fixed points; `radius` is there for ParaView's filter Tube."""
    data = {"muscle": [muscles.owners], "side": [muscles.sides[muscles.owners]]}
    for name, values in (("contraction", muscles.contraction), ("tension_N", muscles.tension)):
        if values is not None:
            data[name] = [np.asarray(values[frame], np.float32)]
    radius = np.repeat(muscles.diameters / 2, np.diff(muscles.begins)).astype(np.float32)
    return meshio.Mesh(
        muscles.points[frame], [("line", muscles.intervals)], point_data={"radius": radius}, cell_data=data
    )
