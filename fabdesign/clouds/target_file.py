"""A target from its file: read, placed in the world, and refused where no cloth could be there."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from fabdesign.clouds.cloud_file import POINTS, Geometry, read_geometry
from fabdesign.clouds.measured_points import sound_cloud
from fabdesign.errors import InputError, note
from fabdesign.geometry.hung_cloth import misplaced
from fabdesign.geometry.placement import MARKERS, UNITS, Placement, PlacementFit, Unit, fit_markers, fit_placement
from fabdesign.nouns.array import Array
from fabdesign.nouns.fabric import Fabric
from fabdesign.study_files.study_targets import TargetFile

MOST = 10_000  # points that are compared: more cost time and say nothing new
FEWEST = 6  # points: as many as a pose has unknowns
_DENSE = 20_000  # points on a mesh by which it is registered


@dataclass(frozen=True, eq=False)
class PlacedTarget:
    points: Array  # (n, 3) m
    geometry: Geometry  # as the file has it
    placement: Placement
    turned_over: Placement | None = None  # of a fitted one that fits as well with front and back changed

    @property
    def markers(self) -> bool:
        """Return whether there are so few points that only the distances from them to the cloth say something."""
        return not self.geometry.is_mesh and len(self.points) < MARKERS


def read_target(target: TargetFile, fabric: Fabric, *, seed: int = 0) -> PlacedTarget:
    """Read a target and place it: POINTS points drawn on a mesh with `seed`, at most MOST of a cloud.

    A cloud of few points is markers: they need not show the cloth's edge. Raises InputError for a file that
    `read_geometry` refuses, for fewer points than FEWEST, and for a target that cannot be a cloth held as `fabric`,
    with the unit, or the registration, that would do.
    """
    if target.points is None:
        geometry = read_geometry(target.file, frame=target.frame)
    else:
        geometry = Geometry(sound_cloud(target.points, str(target.file), unit_known=False))
    rng = np.random.default_rng(seed)
    if geometry.trial and (target.unit != "m" or target.scale != 1):
        raise InputError(f"{target.file}: unit or scale for a trial, which says its own; expected none")
    if geometry.frame is None and target.frame != -1:
        raise InputError(f"{target.file}: frame = {target.frame} of a file that has no frames; expected none")
    target = _in_unit_of(geometry, target)
    factor, turned_over = UNITS[target.unit] * target.scale, None
    if not geometry.is_mesh:  # without what lies too far from the rest to be of this cloth, but for one in another unit
        where, size = f"{target.file}" + f" frame {geometry.frame}" * geometry.trial, max(fabric.width, fabric.height)
        sound = sound_cloud(geometry.points, where, size=size / factor, unit_known=geometry.trial)
        geometry = replace(geometry, points=sound)
    raw = geometry.sample(POINTS, rng)
    if len(raw) < FEWEST:
        raise InputError(f"{target.file}: has {len(raw)} points; expected at least {FEWEST}")
    if len(raw) > MOST and not geometry.trial:
        raw = raw[np.sort(rng.choice(len(raw), MOST, replace=False))]
    if target.place == "fit":
        fit = _fit(geometry, raw, fabric, factor, target)
        if fit.rival is not None:
            ways = " or ".join(p.turn for p in (fit.placement, fit.rival))
            raise InputError(
                f"{target.file}: two of its edges fit the hung one, {ways}; expected one of them as rotation"
            )
        placement, turned_over = fit.placement, fit.turned_over
    else:
        placement = Placement(factor, target.rotation or (0.0, 0.0, 0.0), target.translation)
    points = placement.apply(raw)
    fault = misplaced(points, fabric, part=target.distances == "one way", free=target.free)
    if fault is not None:
        raise InputError(f"{target.file}: {fault}{next(_remedies(geometry, raw, fabric, target), '')}")
    return PlacedTarget(points, geometry, placement, turned_over)


def _in_unit_of(geometry: Geometry, target: TargetFile) -> TargetFile:
    """Return the target in the unit that its file says, where it says one. Raises InputError where the two differ."""
    if geometry.unit is not None and target.unit == "m":
        note(f"{target.file}: its header says {geometry.unit}; read so")
        return replace(target, unit=geometry.unit)
    if geometry.unit not in (None, target.unit):
        raise InputError(f'{target.file}: its header says {geometry.unit}; expected unit = "{geometry.unit}"')
    return target


@dataclass(frozen=True)
class AsTarget:
    """How a command has clouds and meshes read by its options, as a study has its target read by keys. fabric: of the
    cloth that they are to be; None: any."""

    unit: Unit = "m"
    place: Literal["given", "fit"] = "given"
    fabric: Fabric | None = None
    rotation: tuple[float, float, float] | None = None  # degrees, as a study has it

    def target(self, file: Path) -> TargetFile:
        return TargetFile(file, unit=self.unit, place=self.place, rotation=self.rotation)

    def read(self, file: Path) -> Geometry:
        """Return a cloud or mesh whole, in m and where it was placed. Raises InputError like `read_target`, with
        options in place of keys."""
        with keys_as_options():
            if self.fabric is not None:
                placed = read_target(self.target(file), self.fabric)
                return replace(placed.geometry, points=placed.placement.apply(placed.geometry.points), unit="m")
            geometry = read_geometry(file)
            target = _in_unit_of(geometry, self.target(file))
            placement = Placement(UNITS[target.unit], self.rotation or (0.0, 0.0, 0.0))
            return replace(geometry, points=placement.apply(geometry.points), unit="m")


AS_GIVEN = AsTarget()


@contextmanager
def keys_as_options() -> Iterator[None]:
    """Have an error name the option of a command where it names the key of a study."""
    try:
        yield
    except InputError as error:
        message = re.sub(r'\b(unit|place) = "(\w+)"', r"--\1 \2", str(error))
        turn = re.compile(r"\[(-?[\d.e+-]+), (-?[\d.e+-]+), (-?[\d.e+-]+)\](?=.* as rotation)")
        raise InputError(turn.sub(r"\1,\2,\3", message).replace("as rotation", "as --rotation")) from None


def _fit(geometry: Geometry, raw: Array, fabric: Fabric, factor: float, target: TargetFile) -> PlacementFit:
    """Register it with the vertices of a mesh, and points drawn on it closely: its edge is then known exactly. A
    trial's axes are the world's."""
    if fabric.hung != "top":
        raise InputError(f'{target.file}: place = "fit" for a cloth held elsewhere; expected one hung by its top edge')
    rotation = target.rotation or ((0.0, 0.0, 0.0) if geometry.trial else None)
    if not geometry.is_mesh and len(raw) < MARKERS:
        return fit_markers(raw, fabric, factor=factor, rotation=rotation)
    points = raw
    if geometry.is_mesh:
        drawn = geometry.sample(_DENSE, np.random.default_rng(0))
        points = np.concatenate([geometry.points[np.unique(geometry.triangles)], drawn])
    return fit_placement(points, fabric, factor=factor, rotation=rotation, drawn=not geometry.is_mesh)


def _remedies(geometry: Geometry, raw: Array, fabric: Fabric, target: TargetFile) -> Iterator[str]:
    """Yield what would make the target one that the cloth could take, the least change first, as hints."""
    others: list[Unit] = [] if geometry.trial else [unit for unit in UNITS if unit != target.unit]
    for unit in others:
        placement = Placement(UNITS[unit] * target.scale, target.rotation or (0.0, 0.0, 0.0), target.translation)
        if target.place != "fit" and misplaced(placement.apply(raw), fabric) is None:
            yield f' (is it in {unit}? unit = "{unit}")'
    largest = 2 * np.hypot(fabric.width, fabric.height)
    free = replace(target, rotation=None)
    for unit in [target.unit, *others]:
        factor = UNITS[unit] * target.scale
        span = factor * float(np.linalg.norm(np.ptp(raw, axis=0)))
        if fabric.hung != "top" or not largest / 5 < span < largest:
            continue
        fit = _fit(geometry, raw, fabric, factor, free)
        if misplaced(fit.placement.apply(raw), fabric) is None:
            unit_too = "" if unit == target.unit else f'unit = "{unit}" and '
            alone = ", without rotation or translation," if target.rotation or any(target.translation) else ""
            yield f' ({unit_too}place = "fit"{alone} would bring it onto the cloth)'
