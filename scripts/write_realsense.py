"""Write depth images as the RealSense SDK records them: `python scripts/write_realsense.py IMAGES.npz OUT.bag`.

The SDK's software device and recorder need no camera. pyrealsense2 2.56.5 writes `.bag`, 2.59.1 writes `.db3`. The npz
has `depth` (n, rows, columns) uint16, `stamps` (n,) s, `numbers` (n,), `unit` m, `pinhole` fx, fy, cx, cy, `model` and
`coefficients` of the distortion, and may have `colour` (n, rows, columns, 3) uint8 with `depth_to_colour` (3, 4),
`accel` (n, 3) m/s^2 in the depth camera's axes, and a `serial`.
"""

import gc
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


def intrinsics(rs: Any, size: tuple[int, int], pinhole: Any, model: str, coefficients: Any) -> Any:
    """Return the SDK's intrinsics of images of a size (width, height)."""
    made = rs.intrinsics()
    made.width, made.height = size
    made.fx, made.fy, made.ppx, made.ppy = (float(x) for x in pinhole)
    made.model = getattr(rs.distortion, model)
    made.coeffs = [*map(float, coefficients), *[0.0] * 5][:5]
    return made


def stream(rs: Any, kind: Any, uid: int, form: Any, size: int, optics: Any) -> Any:
    """Return a stream of images at 30 Hz."""
    made = rs.video_stream()
    made.type, made.index, made.uid, made.fmt, made.bpp = kind, 0, uid, form, size
    made.width, made.height, made.fps, made.intrinsics = optics.width, optics.height, 30, optics
    return made


def vector(rs: Any, values: Any) -> Any:
    """Return the SDK's vector of three numbers."""
    made = rs.vector()
    made.x, made.y, made.z = (float(x) for x in values)
    return made


def write(arrays: Any, out: Path) -> None:
    """Write the recording `out`."""
    import pyrealsense2 as rs

    depth = arrays["depth"]
    size = depth.shape[2], depth.shape[1]
    optics = intrinsics(rs, size, arrays["pinhole"], str(arrays["model"]), arrays["coefficients"])
    device = rs.software_device()
    device.register_info(rs.camera_info.name, "Virtual D435I")
    device.register_info(rs.camera_info.serial_number, str(arrays.get("serial", "000000000001")))
    module = device.add_sensor("Stereo Module")
    profile = module.add_video_stream(
        stream(rs, rs.stream.depth, 1, rs.format.z16, 2, optics)
    ).as_video_stream_profile()
    module.add_read_only_option(rs.option.depth_units, float(arrays["unit"]))
    colour = arrays.get("colour")
    if colour is not None:
        camera = device.add_sensor("RGB Camera")
        wide = intrinsics(rs, (colour.shape[2], colour.shape[1]), arrays["pinhole"], "none", ())
        shown = camera.add_video_stream(
            stream(rs, rs.stream.color, 2, rs.format.rgb8, 3, wide)
        ).as_video_stream_profile()
        if "depth_to_colour" in arrays:  # (3, 4) turn and shift of a point from the depth camera to the colour camera
            placed = rs.extrinsics()
            placed.rotation = [float(x) for x in arrays["depth_to_colour"][:, :3].T.ravel()]  # column by column
            placed.translation = [float(x) for x in arrays["depth_to_colour"][:, 3]]
            profile.register_extrinsics_to(shown, placed)
    accel = arrays.get("accel")
    if accel is not None:
        motion, moved = device.add_sensor("Motion Module"), rs.motion_stream()
        moved.type, moved.index, moved.uid, moved.fps, moved.fmt = rs.stream.accel, 0, 3, 63, rs.format.motion_xyz32f
        felt = motion.add_motion_stream(moved).as_motion_stream_profile()
    recorder = rs.recorder(str(out), device)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles())
        sensor.start(lambda frame: None)

    def frame(pixels: Any, place: int, channels: int, of: Any) -> Any:
        made = rs.software_video_frame()
        made.pixels, made.bpp, made.stride = np.ascontiguousarray(pixels), channels, channels * pixels.shape[1]
        made.timestamp, made.frame_number = 1e3 * float(arrays["stamps"][place]), int(arrays["numbers"][place])
        made.domain, made.profile = rs.timestamp_domain.hardware_clock, of
        return made

    for place in range(len(depth)):
        image = frame(depth[place], place, 2, profile)
        image.depth_units = float(arrays["unit"])
        stamp = int(1e6 * float(arrays["stamps"][place]))
        module.set_metadata(rs.frame_metadata_value.frame_timestamp, max(stamp, 0))
        module.on_video_frame(image)
        if colour is not None:
            camera.on_video_frame(frame(colour[place], place, 3, shown))
        if accel is not None:
            sample = rs.software_motion_frame()
            sample.data, sample.profile, sample.domain = vector(rs, accel[place]), felt, image.domain
            sample.timestamp, sample.frame_number = image.timestamp, image.frame_number
            motion.on_motion_frame(sample)
        time.sleep(0.012)  # the recorder drops what comes faster than it writes
    time.sleep(0.5)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
    del sensor, sensors, recorder  # it writes the index
    gc.collect()


if __name__ == "__main__":
    with np.load(sys.argv[1]) as content:
        write({name: content[name] for name in content.files}, Path(sys.argv[2]))
