"""The object finder before rendered images: what it proposes, and what becomes of it."""

import base64
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cairn import CairnError, from_ns
from cairn.components.object_recognizer.finder import ObjectFinder
from cairn.planar.messages import with_covariance
from cairn.planar.poses import Pose, wrap
from cairn.schemas.cairn_msgs import ObjectProposal
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import ComponentHarness
from cairn.visual_map.object_models import read_models
from tests.commands import cairn
from tests.components.object_recognizer.conftest import BEGIN_S
from tests.components.object_recognizer.scenes import SIZE, Thing, info, message, pair

pytestmark = pytest.mark.images

UNKNOWN, KNOWN = 77, 1
"""Seeds of pictures: of a thing that was never taught, and of one in the map."""

Placed = tuple[int, float, float, float]
"""A picture by its seed, at x, y [m] in the map, seen from direction [rad]."""

WALL: Placed = (UNKNOWN, 3.0, 0.0, math.pi)
OTHER: Placed = (79, 3.0, 0.1, math.pi)
# Poses from which it is seen, on two visits.
FIRST = [(0.8, -0.6, 0.25), (1.0, -0.2, 0.1), (1.2, 0.2, -0.1), (1.4, 0.6, -0.35)]
AGAIN = [(0.9, 0.0, 0.0), (1.1, 0.5, -0.25)]


class Robot:
    """A finder whose robot stands at poses of the map."""

    def __init__(self, folder: Path, map_file: Path, **parameters: Any) -> None:
        self.proposals_file, self.map_file = folder / "proposals.cairn", map_file
        parameters = {
            "map_file": str(map_file),
            "proposals_file": str(self.proposals_file),
            "least_poses": 4,
            **parameters,
        }
        self.finder = ComponentHarness(ObjectFinder, parameters, start_s=BEGIN_S)
        self.finder.publish("left_info", info())
        self.finder.publish("right_info", info(right=True))

    def visit(
        self, poses: Sequence[Pose], things: Sequence[Placed] = (WALL,), health: float = 1.0
    ) -> list[ObjectProposal]:
        """Look from each pose, after a time elsewhere; return what is proposed then."""
        self.finder.run_for(30.0)
        for noise, pose in enumerate(poses):
            self.finder.run_for(1.5)
            left, right = pair([in_camera(thing, pose) for thing in things], noise)
            self.locate(pose, health, -0.05)
            self.finder.publish("left_image", message(left, self.finder.now))
            self.finder.publish("right_image", message(right, self.finder.now))
            self.locate(pose, health, 0.05)
        return self.proposals()

    def proposals(self) -> list[ObjectProposal]:
        published = self.finder.take("object_proposals")
        return list(published[-1].proposals) if published else []

    def locate(self, pose: Pose, health: float, later_s: float) -> None:
        stamp = from_ns(round((self.finder.now + later_s) * 1e9))
        self.finder.publish(
            "localization",
            LocalizationEstimate(
                header=Header(stamp=stamp, frame_id="map"),
                located=True,
                pose=with_covariance(pose, np.diag([1e-4, 1e-4, 1e-5])),
                health=health,
                position_sd=0.014,
            ),
        )


def in_camera(thing: Placed, robot: Pose) -> Thing:
    seed, x, y, seen_from = thing
    dx, dy, heading = x - robot[0], y - robot[1], robot[2]
    forward = math.cos(heading) * dx + math.sin(heading) * dy
    left = -math.sin(heading) * dx + math.cos(heading) * dy
    return Thing(seed, -left, forward, wrap(seen_from - heading - math.pi))


def image_size(data: bytes) -> tuple[int, int]:
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    rows, columns = image.shape
    return columns, rows


@pytest.fixture
def start(map_file: Path, tmp_path: Path) -> Callable[..., Robot]:
    return lambda **parameters: Robot(tmp_path, map_file, **parameters)


@pytest.mark.accuracy
def test_unknown_thing_is_proposed_accepted_and_not_found_again(
    start: Callable[..., Robot],
) -> None:
    robot = start()
    assert robot.visit(FIRST) == []

    (one,) = robot.visit(AGAIN)

    assert (one.x, one.y) == pytest.approx((3.0, 0.0), abs=0.03)
    assert math.sqrt(one.covariance[0] + one.covariance[3]) < 0.06
    assert one.seen >= 5
    # The picture may have a border, or lack one without features.
    assert one.width == pytest.approx(SIZE[0], rel=0.25)
    assert one.height == pytest.approx(SIZE[1], rel=0.25)
    assert max(image_size(one.picture.tobytes())) <= 160
    (listed,) = robot.finder.request("proposals")["proposals"]
    assert (listed["number"], listed["name"]) == (1, "found 1")
    png = base64.b64decode(robot.finder.request("picture", number=1)["png"])
    assert min(image_size(png)) >= 60

    answer = robot.finder.request("accept", number=1, name="poster")

    assert answer["name"] == "poster"
    (landmark,) = robot.finder.take("accepted_objects")[-1].objects
    assert (landmark.object_id, landmark.name) == (answer["object_id"], "poster")
    assert (landmark.x, landmark.y, landmark.reliability) == (one.x, one.y, 0.5)
    assert list(landmark.covariance) == list(one.covariance)
    model = read_models(robot.map_file).named("poster")
    assert model is not None
    assert model.size == pytest.approx((one.width, one.height))
    assert robot.visit([*FIRST, *AGAIN]) == []
    assert robot.finder.request("proposals") == {"proposals": []}
    robot.visit(FIRST, [OTHER])
    (other,) = robot.visit(AGAIN, [OTHER])
    assert other.number == 2


@pytest.mark.accuracy
def test_rejected_thing_is_not_proposed_again_after_a_restart(
    start: Callable[..., Robot],
) -> None:
    first = start()
    first.visit(FIRST)
    assert len(first.visit(AGAIN)) == 1
    first.finder.component.on_deactivate()

    second = start()
    assert len(second.proposals()) == 1  # it is kept
    assert second.finder.request("reject", number=1) == {"saved": True}
    second.visit(FIRST)
    assert second.visit(AGAIN) == []

    third = start()
    third.visit(FIRST)
    assert third.visit(AGAIN) == []


def test_proposal_is_accepted_automatically_by_parameter(start: Callable[..., Robot]) -> None:
    robot = start(accept="automatically")
    robot.visit(FIRST)

    assert robot.visit(AGAIN) == []

    assert read_models(robot.map_file).named("found 1") is not None


@pytest.mark.accuracy
def test_known_and_moving_things_are_not_proposed(start: Callable[..., Robot]) -> None:
    robot = start()
    moved = (UNKNOWN, 3.0, 0.8, math.pi)

    for things in ([(KNOWN, 3.0, 0.0, math.pi)], [WALL], [moved], [WALL], [moved]):
        assert robot.visit(FIRST, things) == []


def test_nothing_is_found_while_the_pose_is_not_reliable(start: Callable[..., Robot]) -> None:
    robot = start()
    robot.visit(FIRST, health=0.3)

    assert robot.visit([*FIRST, *AGAIN], health=0.3) == []


@pytest.mark.accuracy
def test_poses_may_be_older_than_the_newest_images(start: Callable[..., Robot]) -> None:
    robot = start()

    def look(poses: Sequence[Pose]) -> None:
        robot.finder.run_for(30.0)
        for noise, pose in enumerate(poses):
            robot.finder.run_for(1.5)
            images = pair([in_camera(WALL, pose)], noise)
            # Three pairs arrive before the pose of the first one.
            robot.locate(pose, 1.0, -0.05)
            for later in (0.0, 0.03, 0.06):
                for side, image in zip(("left", "right"), images, strict=True):
                    robot.finder.publish(f"{side}_image", message(image, robot.finder.now + later))
            robot.locate(pose, 1.0, 0.02)

    look(FIRST)
    look(AGAIN)

    assert len(robot.proposals()) == 1


def test_requests_are_checked(start: Callable[..., Robot]) -> None:
    robot = start()
    for verb, arguments, words in (
        ("accept", {"number": 3}, "there is no proposal 3; available: none"),
        ("reject", {"number": "1"}, "number must be an integer"),
        ("accept", {"number": 1, "size": 2}, "unknown request accept"),
        ("forget", {"number": 1}, "unknown request forget"),
    ):
        with pytest.raises(CairnError, match=words):
            robot.finder.request(verb, **arguments)


@pytest.mark.accuracy
def test_proposals_of_a_robot_that_is_off_are_accepted_from_its_file(
    start: Callable[..., Robot], tmp_path: Path
) -> None:
    robot = start()
    robot.visit(FIRST)
    robot.visit(AGAIN)
    robot.finder.component.on_deactivate()
    file, out = str(robot.proposals_file), tmp_path / "pictures"

    listed = cairn("object", "proposals", "--file", file, "--out", str(out), "--json")
    taken = cairn("object", "accept", "1", "--file", file, "--map", str(robot.map_file),
                  "--name", "poster 1")  # fmt: skip
    accepted = cairn(
        "object", "accept", "1", "--file", file, "--map", str(robot.map_file), "--json"
    )

    assert [row["name"] for row in listed.json] == ["found 1"]
    assert cv2.imread(str(out / "1.png")) is not None
    assert "has an object 'poster 1' already; give another name" in taken.err
    assert accepted.json["name"] == "found 1"
    assert read_models(robot.map_file).named("found 1") is not None
    assert cairn("object", "proposals", "--file", file).out == "nothing is proposed\n"
    again = cairn("object", "reject", "1", "--file", file)
    assert "there is no proposal 1; available: none" in again.err
