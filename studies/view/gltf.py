"""An animated GLB: surfaces as morph targets, one a frame; clouds as point meshes shown one after another."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib as gltf
from numpy.typing import NDArray

from studies.view.items import Item
from studies.view.shapes import CLOUD, parts_of, vertex_normals, vertices_of

MOST = 240  # frames of a panel: beyond, evenly spread ones
CLOUD_POINTS = 4000  # of a frame of a cloud
_APART = 1.2  # of the widest panel, from one to the next

Floats = NDArray[np.float32]


def save_glb(items: Sequence[Item], path: Path) -> list[dict[str, object]]:
    """Write panels in metres, y upwards; every panel a node at a place of its own, moved along x from where its file
    says (its `extras` say by how much), its coordinates unchanged. Times begin with the earliest frame. Return how many
    frames of each are kept."""
    scene = _Scene()
    begin = min(float(item.times[0]) for item in items)
    widest = max(float(np.ptp(frame[:, 0])) for item in items for frame in item.frames if len(frame))
    notes: list[dict[str, object]] = []
    for number, item in enumerate(items):
        chosen = np.unique(np.linspace(0, len(item.times) - 1, min(MOST, len(item.times))).astype(np.intp))
        seconds = (item.times[chosen] - begin).astype(np.float32)
        draw = scene.frames_in_turn if item.triangles is None else scene.morphing
        shift = [_APART * widest * number, 0.0, 0.0]
        extras = {"moved_by_m": shift, "times_s": item.times[chosen].tolist()}
        children = draw(item, chosen, seconds)
        scene.roots.append(scene.node(name=item.title, children=children, translation=shift, extras=extras))
        notes.append({"frames_kept": len(chosen)})
    scene.save(path)
    return notes


class _Scene:
    """A glTF asset as it grows."""

    def __init__(self) -> None:
        self._asset = gltf.GLTF2(asset=gltf.Asset(version="2.0", generator="fabdesign"))
        self._animation = gltf.Animation(name="motion")
        self._bytes = bytearray()
        self.roots: list[int] = []

    def node(self, **fields: object) -> int:
        return _add(self._asset.nodes, gltf.Node(**fields))

    def morphing(self, item: Item, chosen: NDArray[np.intp], seconds: Floats) -> list[int]:
        """Return one node, whose mesh is the first frame, with a morph target for every other, and its animation."""
        parts, vertices = parts_of(item), [vertices_of(item)[k] for k in chosen]
        every = np.concatenate([part.triangles for part in parts])
        normals = [vertex_normals(frame, every) for frame in vertices]
        base = gltf.Attributes(POSITION=self._vectors(vertices[0]), NORMAL=self._vectors(normals[0]))
        targets = [
            {"POSITION": self._vectors(at - vertices[0]), "NORMAL": self._vectors(normal - normals[0])}
            for at, normal in zip(vertices[1:], normals[1:], strict=True)
        ]
        primitives = [
            gltf.Primitive(
                attributes=base,
                indices=self._accessor(part.triangles.astype(np.uint32).ravel(), "SCALAR", gltf.ELEMENT_ARRAY_BUFFER),
                material=self._material(part.name, part.colour),
                targets=targets,
            )
            for part in parts
        ]
        names, still = {"targetNames": [f"{item.times[k]:.4f} s" for k in chosen[1:]]}, [0.0] * len(targets)
        mesh = gltf.Mesh(name=item.title, primitives=primitives, weights=still, extras=names)
        node = self.node(name=f"{item.title}, shape", mesh=_add(self._asset.meshes, mesh))
        if targets:
            weights = np.eye(len(chosen), dtype=np.float32)[:, 1:].ravel()
            self._animate(node, "weights", seconds, self._accessor(weights, "SCALAR"), "LINEAR")
        return [node]

    def frames_in_turn(self, item: Item, chosen: NDArray[np.intp], seconds: Floats) -> list[int]:
        """Return a node a frame, of which one has its size at a time: the points of a cloud are not the same ones
        later."""
        material, nodes = self._material("cloud", CLOUD), []
        for place, k in enumerate(chosen):
            points = np.asarray(item.frames[k], np.float32)
            shown = points[:: -(-len(points) // CLOUD_POINTS)]
            primitive = gltf.Primitive(
                attributes=gltf.Attributes(POSITION=self._vectors(shown)), mode=gltf.POINTS, material=material
            )
            name = f"{item.title}, {item.times[k]:.4f} s"
            mesh = _add(self._asset.meshes, gltf.Mesh(name=name, primitives=[primitive]))
            nodes.append(self.node(name=name, mesh=mesh, scale=[float(place == 0)] * 3))
            if len(chosen) > 1:
                sizes = np.repeat(np.eye(len(chosen), dtype=np.float32)[place][:, None], 3, axis=1)
                self._animate(nodes[-1], "scale", seconds, self._accessor(sizes, "VEC3"), "STEP")
        return nodes

    def save(self, path: Path) -> None:
        self._asset.scenes.append(gltf.Scene(nodes=self.roots))
        self._asset.scene = 0
        if self._animation.channels:
            self._asset.animations.append(self._animation)
        self._asset.buffers.append(gltf.Buffer(byteLength=len(self._bytes)))
        self._asset.set_binary_blob(bytes(self._bytes))
        self._asset.save_binary(str(path))

    def _animate(self, node: int, what: str, seconds: Floats, values: int, interpolation: str) -> None:
        times = self._accessor(seconds, "SCALAR", limits=True)
        sampler = gltf.AnimationSampler(input=times, output=values, interpolation=interpolation)
        target = gltf.AnimationChannelTarget(node=node, path=what)
        channel = gltf.AnimationChannel(sampler=_add(self._animation.samplers, sampler), target=target)
        self._animation.channels.append(channel)

    def _material(self, name: str, colour: tuple[float, float, float]) -> int:
        shine = gltf.PbrMetallicRoughness(baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=0.9)
        return _add(self._asset.materials, gltf.Material(name=name, pbrMetallicRoughness=shine, doubleSided=True))

    def _vectors(self, array: Floats) -> int:
        return self._accessor(array.astype(np.float32), "VEC3", gltf.ARRAY_BUFFER, limits=True)

    def _accessor(self, array: NDArray[Any], kind: str, target: int | None = None, *, limits: bool = False) -> int:
        """Return the accessor of an array that is appended to the buffer; its smallest and largest entries where glTF
        asks for them."""
        offset, data = len(self._bytes), np.ascontiguousarray(array).tobytes()
        self._bytes += data
        view = gltf.BufferView(buffer=0, byteOffset=offset, byteLength=len(data), target=target)
        number = gltf.UNSIGNED_INT if array.dtype == np.uint32 else gltf.FLOAT
        ends = array.reshape(len(array), -1) if limits else None
        accessor = gltf.Accessor(
            bufferView=_add(self._asset.bufferViews, view),
            componentType=number,
            count=len(array),
            type=kind,
            min=None if ends is None else ends.min(axis=0).tolist(),
            max=None if ends is None else ends.max(axis=0).tolist(),
        )
        return _add(self._asset.accessors, accessor)


def _add(things: list[Any], one: Any) -> int:
    """Return the number of what is appended to a list, by which glTF names it."""
    things.append(one)
    return len(things) - 1
