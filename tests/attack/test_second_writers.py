"""A peer without rights publishes valid messages beside the components, while the robot drives.

Inputs that are not exclusive accept them; so may every program of the robot's user. At worst the
robot stands with a reason: the velocity gate believes only its own scanner, base and navigator.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Final

import pytest

from cairn import CairnError
from cairn.client.navigation import NavigationGoal
from cairn.schemas.cairn_nav_msgs import NavigationStatus
from cairn.schemas.message import type_name
from tests.attack.conftest import Cases
from tests.attack.inputs import CODEC, Topic, topics
from tests.attack.robot import MOST_MEMORY_MB, AttackedRobot
from tests.attack.test_peers import Peer
from tests.schemas.arbitrary import samples

GOAL: Final = (6.6, 1.8, 0.0)
_GOAL_LIMIT_S: Final = 20.0
_ATTACK_S: Final = 3.0
_PERIOD_S: Final = 0.02
_PHYSICS: Final = frozenset({"world_state", "world_geometry", "wheel_motion", "kidnap"})
"""What the simulation takes for the world itself: a real robot has no such topics."""

_COMMANDS: Final = frozenset({"goal_pose", "initialpose", "emergency_stop", "hardware_stop"})
"""Orders of an operator, which are obeyed."""

WRITTEN: Final = [topic for name, topic in topics().items() if name not in _PHYSICS | _COMMANDS]


@pytest.fixture(scope="module")
def peer(robot: AttackedRobot) -> Iterator[Peer]:
    """The attacker."""
    with robot.attacker() as session:
        yield Peer(session)


def publish_for(seconds: float, peer: Peer, messages: Mapping[Topic, list[bytes]]) -> None:
    """Publish messages on all topics at 50 Hz."""
    end = time.monotonic() + seconds
    pause = threading.Event()
    for number in itertools.count():
        for topic, valid in messages.items():
            peer.put(topic.key, valid[number % len(valid)], peer.attachment().encode())
        pause.wait(_PERIOD_S)
        if time.monotonic() > end:
            return


def stands_or_drives(mission: NavigationGoal) -> str:
    """Return how a mission goes on: success, or the reason for which it does not."""
    try:
        result = mission.result(_GOAL_LIMIT_S)
    except CairnError as error:  # it is under way, or was replaced by a forged one
        return str(error)
    return "succeeded" if result.state == NavigationStatus.SUCCEEDED else result.reason


def test_scans_and_odometry_of_a_second_writer_are_refused_by_gate_and_localizer(
    robot: AttackedRobot, peer: Peer
) -> None:
    sensors = {
        topics()[name]: [CODEC.encode(one) for one in samples(type_name(topics()[name].message), 9)]
        for name in ("scan", "odom")
    }
    guarded = [
        (topic, component, position)
        for topic in sensors
        for position, (component, _) in enumerate(topic.readers)
        if component in ("velocity_gate", "localizer")
    ]

    def refused() -> bool:
        """Whether each of these readers has refused ten messages; on a busy computer some wait."""
        publish_for(0.5, peer, sensors)
        robot.next_statuses()
        return all(robot.ports(topic)[position].refused >= 10 for topic, _, position in guarded)

    assert any(refused() for _ in range(10))
    for topic, component, _ in guarded:
        robot.await_log(component, f"refused message on {topic.name} from .*not signed")


def test_afterward_the_robot_stands_or_drives_on_and_is_unharmed(
    robot: AttackedRobot,
    peer: Peer,
    cases: Cases,
    record_property: Callable[[str, object], None],
) -> None:
    messages = {
        topic: [CODEC.encode(one) for one in samples(type_name(topic.message), 20)]
        for topic in WRITTEN
    }
    cases(messages)
    with robot.client.go(*GOAL):
        publish_for(_ATTACK_S, peer, messages)
    robot.next_statuses()
    with robot.client.go(*GOAL) as mission:
        assert stands_or_drives(mission)

    harm = robot.harm()
    record_property("harm", vars(harm))
    assert (harm.collisions, harm.replaced) == (0, []), robot.run
    assert harm.peak_mb <= MOST_MEMORY_MB
