"""Reads hostile files with the product's readers, each in a process with little memory.

`python -m tests.hostile_reading KIND/NAME ...` prints a line of JSON for each: what the reader
raised, the processor time that it took [s], and the highest memory use of its process [MB]. A
process is forked for each file, so that the readers are imported once, and no file adds to the
memory of another one.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn

from cairn.errors import CairnError
from tests.hostile_files import HOSTILE

MOST_MEMORY_MB: Final = 500
"""No process may use more memory for a hostile file [MB]."""

MOST_SECONDS: Final = 5.0
"""No file may take more processor time [s]; a reader that waits is killed."""

_ADDRESS_SPACE: Final = 4 << 30  # libraries and threads take 1.5 GB of it, a bomb the rest
_KILLED_AFTER_S: Final = 12 * MOST_SECONDS  # of real time, also on a machine that is busy
_MODULES: Final = (
    "components.replay_devices.open_recording",
    "components.simulation.textures",
    "components.slam.graph_history",
    "components.simulation.world_file",
    "deployment.yaml_document",
    "planar.map_file",
    "planar.zones",
    "recording.decoding",
    "recording.reader",
    "vision.camera_file",
    "vision.images",
    "visual_map.landmark_store",
    "visual_map.object_models",
)
"""Modules that are imported before the processes are forked: importing is not reading."""


@dataclass(frozen=True)
class Outcome:
    """How reading a file ended: type and text of the error, processor time [s], peak memory."""

    error: str
    text: str
    seconds: float
    peak_mb: float


def read_all(cases: Iterable[str]) -> dict[str, Outcome]:
    """Read files, named `kind/name`, each in a process of bounded memory and time."""
    listed = list(cases)
    done = subprocess.run(
        [sys.executable, "-m", "tests.hostile_reading", *listed],
        capture_output=True,
        text=True,
        timeout=30 + 2 * _KILLED_AFTER_S * len(listed),
        check=False,
    )
    outcomes = {
        case: Outcome(**json.loads(line))
        for case, line in zip(listed, done.stdout.splitlines(), strict=False)
    }
    assert len(outcomes) == len(listed), f"died in {listed[len(outcomes)]}: {done.stderr[-2000:]}"
    return outcomes


def _deployment(file: Path) -> None:
    from cairn.deployment.yaml_document import read_document

    _, problems = read_document(file)
    if problems:
        raise CairnError(str(problems[0]))


def _world(file: Path) -> None:
    from cairn.components.simulation.world_file import read_world

    read_world(file)


def _texture(file: Path) -> None:
    from cairn.components.simulation.textures import object_picture
    from cairn.components.simulation.world_file import read_world

    for thing in read_world(file).objects:
        object_picture(thing.texture or "", thing.id, thing.size)


def _grid_map(file: Path) -> None:
    from cairn.planar.map_file import read_map

    read_map(file)


def _camera_file(file: Path) -> None:
    from cairn.vision.camera_file import read_camera

    read_camera(file)


def _picture(file: Path) -> None:
    from cairn.vision.images import read_image

    read_image(file)


def _video(file: Path) -> None:
    from cairn.components.replay_devices.open_recording import open_recording

    images = open_recording(file, image_rate_hz=25.0).images()
    assert images is not None
    for index in range(len(images.stamps)):
        images.load(index)


def _recording(path: Path) -> None:
    from cairn.components.replay_devices.open_recording import open_recording

    recording = open_recording(path)
    recording.scans()
    recording.odometry()


def _mcap(file: Path) -> None:
    from cairn.recording.decoding import MessageDecoder
    from cairn.recording.reader import McapRecording

    decoder = MessageDecoder()
    with McapRecording(file) as recording:
        for message in recording.messages():
            decoder.decode(message)
        recording.latched_at(recording.end_ns)
        for attachment in recording.attachments:
            recording.read_attachment(attachment)
        if recording.notes:
            raise CairnError("; ".join(recording.notes))


def _zones(file: Path) -> None:
    from cairn.planar.zones import read_zones

    read_zones(file)


def _visual_map(file: Path) -> None:
    from cairn.visual_map.landmark_store import open_landmarks
    from cairn.visual_map.object_models import read_models

    with open_landmarks(file, read_only=True) as store:
        store.landmarks()
    read_models(file)


def _graph(file: Path) -> None:
    from cairn.components.slam.graph_file import read_graph
    from cairn.components.slam.graph_history import read_log

    read_graph(file)
    read_log(file)


READERS: Final[Mapping[str, Callable[[Path], Any]]] = {
    "deployment": _deployment,
    "world": _world,
    "texture": _texture,
    "grid_map": _grid_map,
    "camera_file": _camera_file,
    "picture": _picture,
    "video": _video,
    "recording": _recording,
    "mcap": _mcap,
    "visual_map": _visual_map,
    "zones": _zones,
    "graph": _graph,
}


def _read(case: str) -> Outcome:
    kind, _, name = case.partition("/")
    with tempfile.TemporaryDirectory() as folder:
        file, _ = _forked(lambda: str(HOSTILE[kind][name].build(Path(folder))))
        found, peak_mb = _forked(lambda: _attempt(READERS[kind], Path(file)))
    error, text, seconds = found if found else ("killed", "", _KILLED_AFTER_S)
    return Outcome(error, text, seconds, peak_mb)


def _attempt(reader: Callable[[Path], Any], file: Path) -> tuple[str, str, float]:
    """Return what a reader raised, type and text, and the processor time that it took [s]."""
    begin = time.process_time()
    error, text = "nothing", ""
    try:
        reader(file)
    except Exception as raised:
        error = "CairnError" if isinstance(raised, CairnError) else type(raised).__name__
        text = str(raised)[:1000]
    return error, text, round(time.process_time() - begin, 3)


def _forked(call: Callable[[], Any]) -> tuple[Any, float]:
    """Return the result of a call in a process of its own, and its peak of memory [MB].

    The result is None if the process died, or was killed as it did not end.
    """
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        _answer(call, writing)
    os.close(writing)
    with open(reading, encoding="utf-8") as answer:
        if not select.select([answer], [], [], _KILLED_AFTER_S)[0]:
            os.kill(pid, signal.SIGKILL)
        text = answer.read()
    _, _, usage = os.wait4(pid, 0)
    return (json.loads(text) if text else None), round(usage.ru_maxrss / 1024, 1)


def _answer(call: Callable[[], Any], writing: int) -> NoReturn:
    try:
        os.write(writing, json.dumps(call()).encode())
    finally:
        os._exit(0)


if __name__ == "__main__":
    for module in _MODULES:
        importlib.import_module(f"cairn.{module}")
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    for argument in sys.argv[1:]:
        sys.stdout.write(json.dumps(vars(_read(argument))) + "\n")
        sys.stdout.flush()
