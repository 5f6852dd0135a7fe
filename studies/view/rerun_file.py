"""A recording that the Rerun viewer plays."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun

from studies.view.items import Item
from studies.view.shapes import CLOUD, parts_of, vertex_normals, vertices_of


def save_recording(items: Sequence[Item], path: Path) -> None:
    """Write every panel as an entity PANEL_NUMBER/PART in metres, y upwards, on the timeline `time` in s after rest;
    muscles with contraction and tension [N] of their intervals as scalars' means."""
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
            _log_states(recording, name, item, k)
    recording.flush()
    recording.disconnect()


def _log_states(recording: rerun.RecordingStream, name: str, item: Item, frame: int) -> None:
    """Log each muscle's mean contraction, and tension [N], over its intervals."""
    if item.muscles is None:
        return
    for what, values in (("contraction", item.muscles.contraction), ("tension_N", item.muscles.tension)):
        if values is None:
            continue
        for number in range(len(item.muscles.sides)):
            mean = float(values[frame, item.muscles.owners == number].mean())
            recording.log([name, what, f"muscle {number}"], rerun.Scalars(mean))


def _bytes(colour: tuple[float, float, float]) -> list[int]:
    return [round(255 * share) for share in colour]
