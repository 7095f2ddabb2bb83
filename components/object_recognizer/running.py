"""What commands take from a running robot: its camera's newest image, and where its objects are."""

from __future__ import annotations

import queue
from pathlib import Path

from cairn import CairnError
from cairn.bus.codec import Codec
from cairn.bus.control import request
from cairn.cli.connection import Connection, resolve
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.sensor_msgs import Image
from cairn.vision.images import Gray, gray_of

PLUGIN = "object_recognizer"
_LIMIT_S = 5.0


def newest_image(connection: Connection, topic: str, robot: str) -> tuple[str, Gray]:
    """The next image on a topic, and the topic's full name.

    Raises `CairnError` if there is no such topic of images, or if none comes within 5 s.
    """
    codec = Codec()
    writers = {end.topic: end for end in connection.endpoints() if end.kind == "MP"}
    full = resolve(sorted(writers), topic, robot)
    writer = writers[full]
    if writer.type_name != type_name(Image):
        raise CairnError(
            f"{full} carries {writer.type_name}, not images: give the topic of a camera's images "
            "by --topic"
        )
    with connection.listen(writer.data_key) as samples:
        try:
            sample = samples.get(timeout=_LIMIT_S)
        except queue.Empty:
            raise CairnError(
                f"no image has come on {full} within {_LIMIT_S:g} s: look after the camera"
            ) from None
    try:
        return full, gray_of(codec.decode(Image, sample.payload.to_bytes()))
    except (InvalidMessage, CairnError) as error:
        raise CairnError(f"{full}: {error}") from error


def map_of_recognizer(connection: Connection, robot: str) -> Path | None:
    """The map file whose objects the robot recognizes; None if no recognizer runs."""
    running = [name for name, status in connection.statuses().items() if status.plugin == PLUGIN]
    if not running:
        return None
    name = resolve(running, running[0].rpartition("/")[2], robot)
    parameters = request(
        connection.session, connection.domain, name, "parameters", {}, timeout_s=_LIMIT_S
    )
    return Path(next(entry["value"] for entry in parameters if entry["name"] == "map_file"))
