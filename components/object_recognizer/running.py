"""What commands read from a running robot: an image of its camera, the path of its map."""

from __future__ import annotations

from pathlib import Path

from cairn import CairnError
from cairn.client import NoMessageError, Robot
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.sensor_msgs import Image
from cairn.vision.images import Gray, gray_of

PLUGIN = "object_recognizer"
_LIMIT_S = 5.0


def newest_image(robot: Robot, topic: str) -> tuple[str, Gray]:
    """Return the next image on a topic, after the topic's full name.

    Raises `CairnError` if there is no such topic of images, or if none arrives within 5 s.
    """
    publisher = robot.find_topic(topic)
    full = publisher.topic
    if publisher.type_name != type_name(Image):
        raise CairnError(
            f"{full} carries {publisher.type_name}, not images: give the topic of a camera's "
            "images by --topic"
        )
    try:
        with robot.subscribe(full, Image) as images:
            return full, gray_of(images.next(_LIMIT_S))
    except NoMessageError:
        raise CairnError(
            f"no image arrived on {full} within {_LIMIT_S:g} s: check the camera"
        ) from None
    except (InvalidMessage, CairnError) as error:
        raise CairnError(f"{full}: {error}") from error


def map_of_recognizer(robot: Robot) -> Path | None:
    """Return the map file whose objects the robot recognizes; None if no recognizer runs."""
    name = robot.component_of(PLUGIN)
    return Path(robot.parameters(name)["map_file"].value) if name is not None else None
