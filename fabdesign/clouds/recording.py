"""Recordings: raw clouds of several depth sensors, `fabdesign.recording/1`."""

import filecmp
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tomlkit
from numpy.typing import NDArray

from fabdesign.clouds.cloud_file import read_cloud
from fabdesign.clouds.mcap_file import read_mcap
from fabdesign.clouds.measured_points import sound_cloud
from fabdesign.clouds.ply import write_ply
from fabdesign.depth.sensor import NO_CUT, Cut, SeenTarget, Sensor, depth_stream
from fabdesign.depth.stream import DepthStream, left_out_line, pair_frames, paired_as_stamped
from fabdesign.errors import InputError, note
from fabdesign.files.design_file import read_design, write_design
from fabdesign.files.pressure_file import NO_LOG, PressureLog, read_pressure_log, write_pressures
from fabdesign.formats.codec import Encoder, decode
from fabdesign.formats.lab_table import require_seconds
from fabdesign.formats.schema import ABOVE_0, FileUnit, Key, Second
from fabdesign.formats.table import Table, load_toml
from fabdesign.formats.toml_file import file_name, file_stem
from fabdesign.nouns.array import Array
from fabdesign.nouns.design import Design
from fabdesign.nouns.pressure import PressureProgram
from fabdesign.runtime.effort import LONGEST

Convention = Literal["forward", "backward"]  # z forward and y down; or (x, -y, -z), as RealSense SDKs export

FORMAT = "fabdesign.recording/1"
_FRAMES = 9999  # NNNN has four digits
_OTHER_RATE = 1.5  # times the declared interval: the stamps are of another recording
_SIZE = 4.0  # m; a cloud ten times as far from its camera is in another unit


@dataclass(frozen=True, eq=False)
class Recording:
    """The content of a folder; clouds are read when asked for."""

    folder: Path
    name: str
    design: Design
    times: Array  # (T,) s after rest
    sensors: tuple[Sensor, ...]
    program: PressureProgram
    convention: Convention = "forward"
    mcap: Path | None = None  # a file of ROS 2 with the clouds of all sensors, in the place of `frames`
    clouds: Mapping[str, Sequence[Array]] = field(default_factory=dict)  # of each sensor in it, one a time
    depth: tuple[DepthStream, ...] = ()  # of each sensor, where they have depth images in place of clouds
    chosen: NDArray[np.intp] = field(default_factory=lambda: np.zeros((0, 0), np.intp))  # (T, sensors) of images
    left_out: str = ""  # a line on frames that are not among `times`, since a sensor lost them
    cut: Cut = NO_CUT
    log: PressureLog = NO_LOG
    target: SeenTarget | None = None

    def frame(self, sensor: Sensor, index: int) -> Array:
        """Return (n, 3) m, in the camera's own frame, z forward and y down. Raises InputError."""
        if self.depth:
            column = self.sensors.index(sensor)
            return self.depth[column].cloud(int(self.chosen[index, column]))
        if self.mcap is not None:
            what = f"{self.mcap}: {sensor.topic}, frame {index}"
            return self._ahead(sound_cloud(self.clouds[sensor.name][index], what, size=_SIZE), what)
        file = _cloud_file(self._stems(index, sensor), f"frame {index}", sensor)
        before = self.sensors[: self.sensors.index(sensor)] if sensor in self.sensors else ()
        for other, k in ([(sensor, index - 1)] if index else []) + [(other, index) for other in before]:
            if any(filecmp.cmp(file, its, shallow=False) for its in _there(self._stems(k, other))):
                note(f"{file}: repeats the cloud of frame {k} of {other.name}: the camera may have lost one")
        return self._ahead(read_cloud(file, size=_SIZE), str(file))

    def _stems(self, index: int, sensor: Sensor) -> tuple[Path, Path]:
        number, frames = f"{index:04d}", self.folder / "frames"
        return frames / number / sensor.name, frames / sensor.name / number

    def has_reference(self) -> bool:
        return (self.folder / "reference").is_dir()

    def reference(self, sensor: Sensor) -> Array:
        """Return (n, 3) m: the unloaded cloth as the sensor sees it. Raises InputError."""
        file = _cloud_file((self.folder / "reference" / sensor.name,), "reference", sensor)
        return self._ahead(read_cloud(file, size=_SIZE), str(file))

    def _ahead(self, cloud: Array, what: str) -> Array:
        """Return it with z forward and y down; points that lie behind the camera are refused."""
        if self.convention == "backward":
            cloud = cloud * [1.0, -1.0, -1.0]
        if np.median(cloud[:, 2]) <= 0:
            other = "forward" if self.convention == "backward" else "backward"
            raise InputError(f"{what}: its points lie behind the camera; expected z ahead (convention {other}?)")
        return cloud


def _there(stems: Sequence[Path]) -> list[Path]:
    files = (stem.with_name(stem.name + suffix) for stem in stems for suffix in (".ply", ".npz"))
    return [file for file in files if file.is_file()]


def _cloud_file(stems: Sequence[Path], what: str, sensor: Sensor) -> Path:
    if not (there := _there(stems)):
        raise InputError(f"{what}: sensor {sensor.name} is missing; expected {stems[0]}.ply or .npz")
    if len(there) > 1:
        raise InputError(f"{what}: sensor {sensor.name} has {there[0]} and {there[1]}; expected one of them")
    return there[0]


@dataclass(frozen=True, eq=False)
class RecordingKeys:
    """A recording as its file has it."""

    name: Annotated[str, Key(absent=lambda table: table.file.resolve().parent.name), "by default the folder's"]
    design: Annotated[Design, Key(file=read_design), "of the specimen"]
    description: Annotated[str, Key(brief=True), "where it comes from"] = ""
    times: Annotated[tuple[Second, ...] | None, "after rest, one a frame"] = None
    frame_rate: Annotated[float | None, FileUnit("Hz"), ABOVE_0, "in place of times"] = None
    mcap: Annotated[str, Key(brief=True), "a file of ROS 2 with all clouds, in place of frames"] = ""
    sensors: tuple[Sensor, ...] = ()
    cut: Annotated[Cut, Key(brief=True), "what of the depth images is the cloth"] = NO_CUT
    target: Annotated[SeenTarget | None, Key(brief=True), "that the cameras saw, for their poses"] = None
    pressure: Annotated[PressureLog, Key(brief=True), "the log of pressures, where it is no pressure.csv"] = NO_LOG

    def resolved(self, table: Table) -> "RecordingKeys":
        """Raise InputError for no sensors, two of one name, and times that do not rise."""
        if not self.sensors:
            raise table.error("no [[sensors]]")
        names = [sensor.name for sensor in self.sensors]
        if len(set(names)) < len(names):
            raise table.error(f"two sensors have one name: {', '.join(names)}")
        for sensor in self.sensors:
            if sensor.has_depth != self.sensors[0].has_depth:
                raise table.error("some sensors have depth images, others clouds; expected one kind")
            if not sensor.has_depth and bool(self.mcap) != (sensor.topic is not None):
                expected = "a topic for each sensor" if self.mcap else 'mcap = "FILE", where a sensor has a topic'
                raise table.bad("mcap", expected)
        if self.times is None:
            if self.frame_rate is None and not self.sensors[0].has_depth:
                raise table.missing("frame_rate")
            return self
        times = np.array(self.times)
        if len(times) == 0 or times[0] < 0 or (np.diff(times) <= 0).any():
            raise table.bad("times", "seconds after rest that rise")
        require_seconds(times, table.where)
        if times[-1] > LONGEST:
            raise table.error(f"times go to {times[-1]:.6g} s; expected seconds after rest, {LONGEST:g} at most")
        interval, rate = (np.median(np.diff(times)) if len(times) > 1 else 0.0), self.frame_rate
        if interval and rate and not 1 / _OTHER_RATE < rate * interval < _OTHER_RATE:
            note(f"{table.where}: times has a frame every {interval:.3g} s, and frame_rate = {rate:g}; times counts")
        return self


def read_recording(path: Path | str, *, convention: Convention = "forward") -> Recording:
    """Read a recording: its folder or its `recording.toml`. Raises InputError.

    Clouds lie in frames/NNNN/SENSOR.ply or frames/SENSOR/NNNN.ply, as PLY or as npz with `points`, or in an MCAP,
    each sensor's on a topic.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "recording.toml"
    keys, folder, where = decode(RecordingKeys, load_toml(path, FORMAT)), path.parent, str(path)
    mcap = folder / file_name(keys.mcap, where) if keys.mcap else None
    streams = tuple(filter(None, (depth_stream(sensor, folder, mcap) for sensor in keys.sensors)))
    content: dict[str, Any] = {}
    if streams:
        if len(streams) != len(keys.sensors):
            raise InputError(f"{where}: some sensors have depth images, others clouds; expected one kind")
        content["depth"], content["chosen"] = paired_as_stamped(streams, keys.frame_rate, where)
        stamps = content["depth"][0].stamps
        times = stamps[content["chosen"][:, 0]] - stamps.min()
    elif mcap is not None:
        times, content = _of_mcap(keys, mcap)
    else:
        times = _times(keys, folder)
    require_seconds(times, where if streams or mcap is None else str(mcap))
    program = read_pressure_log(keys.pressure, folder, keys.design)
    if not streams and times[-1] > program.duration + 1.5 * float(np.diff(times, prepend=0.0).max()):
        note(f"{folder / keys.pressure.file}: ends at {program.duration:.3g} s, the frames at {times[-1]:.3g} s")
    content |= {"cut": keys.cut, "log": keys.pressure, "target": keys.target}
    return Recording(folder, keys.name, keys.design, times, keys.sensors, program, convention, **content)


def write_recording(
    folder: Path,
    design: Design,
    program: PressureProgram,
    times: Array,
    sensors: Sequence[Sensor],
    frames: Sequence[Mapping[str, Array]],
    reference: Mapping[str, Array],
) -> None:
    """Write a recording into `folder`: clouds (n, 3) m by sensor name, in each camera's own frame."""
    design_file = f"{file_stem(design.name)}.toml"
    rounded = [Sensor(each.name, np.round(each.camera_to_world, 6), each.topic) for each in sensors]
    instants = tuple(round(float(t), 6) for t in times)
    keys = RecordingKeys(folder.name, design, times=instants, sensors=tuple(rounded))
    file = folder / "recording.toml"
    document = {"format": FORMAT} | Encoder(file, {Design: lambda design: design_file}).encode(keys)
    write_design(design, folder / design_file)
    write_pressures(program, folder / "pressure.csv")
    for name, cloud in reference.items():
        write_ply(folder / "reference" / f"{name}.ply", cloud)
    for index, clouds in enumerate(frames):
        for name, cloud in clouds.items():
            write_ply(folder / "frames" / f"{index:04d}" / f"{name}.ply", cloud)
    file.write_text(tomlkit.dumps(document), encoding="utf-8", newline="\n")


def _of_mcap(keys: RecordingKeys, mcap: Path) -> tuple[Array, dict[str, Any]]:
    """Return the times of an MCAP's frames, and what a recording says of them: by the stamps, where these say
    something, else in the order of the first sensor's clouds, from one interval after rest on. Raises InputError."""
    given, by_topic = None if keys.times is None else np.array(keys.times), read_mcap(mcap)
    rate = keys.frame_rate if given is None else None
    topics = [str(sensor.topic) for sensor in keys.sensors]
    for topic in topics:
        if topic not in by_topic:
            raise InputError(f"{mcap}: no clouds on {topic}; expected one of {', '.join(by_topic)}")
    stamps = [by_topic[topic].stamps for topic in topics]
    if (pairs := pair_frames(stamps)) is None:
        if len(topics) > 1:
            note(f"{mcap}: its stamps do not say which clouds are of one frame; they are paired in their order")
        times = given if given is not None else np.arange(1, len(stamps[0]) + 1) / (rate or 1.0)
        for topic, its in zip(topics, stamps, strict=True):
            if len(its) != len(times):
                raise InputError(f"{mcap}: {len(its)} clouds on {topic}; expected {len(times)}, one a time")
        kept, left_out = np.tile(np.arange(len(times))[:, None], len(topics)), ""
    else:
        if rate is not None and not 1 / _OTHER_RATE < rate * pairs.interval < _OTHER_RATE:
            raise InputError(f"{mcap}: a cloud every {pairs.interval:.4g} s by their stamps; expected {1 / rate:.4g} s")
        if given is not None and len(given) != len(pairs.complete):
            raise InputError(f"{mcap}: {len(pairs.complete)} frames by their stamps; expected {len(given)}, one a time")
        times = given if given is not None else np.round(1 / (rate or 1.0) + pairs.time, 6)
        if left_out := left_out_line(pairs, topics, times, str(mcap)):
            note(left_out)
        times, kept = times[pairs.complete], pairs.clouds[pairs.complete]
    columns = zip(keys.sensors, topics, kept.T, strict=True)
    clouds = {s.name: [by_topic[topic].clouds[k] for k in numbers] for s, topic, numbers in columns}
    return times, {"mcap": mcap, "clouds": clouds, "left_out": left_out}


def _times(keys: RecordingKeys, folder: Path) -> Array:
    """Return the frames' times; with a `frame_rate` as many as there are frame folders, or files of the first sensor.
    Where there are more than times it says which are left out."""
    frames = folder / "frames"
    by_sensor = frames / keys.sensors[0].name
    stems = [p.stem for p in (by_sensor if by_sensor.is_dir() else frames).glob("[0-9]*")]
    last = max((int(stem) for stem in stems if stem.isdecimal()), default=-1)
    if keys.times is not None:
        if last >= (count := len(keys.times)):
            note(f"{frames}: has frames to {last}, and {count} times; those from {count} are left out")
        return np.array(keys.times)
    if last < 0:
        raise InputError(f"{frames}: no frames; expected NNNN/SENSOR.ply or SENSOR/NNNN.ply")
    if last > _FRAMES:
        raise InputError(f"{frames}: frame {last}; expected numbers from 0 to {_FRAMES}")
    return np.arange(1, last + 2) / (keys.frame_rate or 1.0)
