"""A robot on a bus of its own that publishes transforms, as components do."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from cairn import LATCHED, RELIABLE, from_ns
from cairn.bus.bus import Publisher
from cairn.bus.keys import EndpointEntity
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.geometry_msgs import TransformStamped
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from cairn.tf import Transform
from tests.cairn.bus.network import Network, eventually

PERIOD_S = 0.02


class PublishedFrames:
    """The frames map, odom, base_link and laser of a robot; `stop` leaves them as they are."""

    def __init__(self, bus: ZenohBus, robot: str = "robot") -> None:
        self._bus = bus
        self._robot = robot
        self._ended = threading.Event()
        self._nodes = [bus.node(f"/{robot}/root", print)]
        self._nodes[0].advertise(f"/{robot}/component_status", ComponentStatus, LATCHED)
        self._localizer = self.publisher("localizer")
        self._base = self.publisher("base")
        self.static = self.publisher("robot_frames", static=True)
        laser = stamped(0, "base_link", "laser", Transform((0.1, 0.0, 0.2)))
        self.static.publish(TFMessage(transforms=(laser,)))
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def publisher(self, node: str, *, static: bool = False) -> Publisher:
        """One more publisher of this robot's transforms."""
        topic, qos = ("tf_static", LATCHED) if static else ("tf", RELIABLE)
        member = self._bus.node(f"/{self._robot}/{node}", print)
        self._nodes.append(member)  # a publisher that is not referred to ends
        return member.advertise(f"/{self._robot}/{topic}", TFMessage, qos)

    def stop(self) -> None:
        """Publish nothing more."""
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        number = 0
        while not self._ended.wait(PERIOD_S):
            now = time.time_ns()
            odom = Transform.from_roll_pitch_yaw(0.0, 0.0, 0.5, (1.0, 2.0, 0.0))
            if number % 2 == 0:
                message = TFMessage(transforms=(stamped(now, "map", "odom", odom),))
                self._localizer.publish(message)
            base = stamped(now, "odom", "base_link", Transform((3.0, 0.0, 0.0)))
            self._base.publish(TFMessage(transforms=(base,)))
            number += 1


def stamped(now: int, parent: str, child: str, transform: Transform) -> TransformStamped:
    return TransformStamped(
        header=Header(stamp=from_ns(now), frame_id=parent),
        child_frame_id=child,
        transform=transform.to_message(),
    )


def await_announced(network: Network, *robots: str) -> None:
    """Wait until the router knows these robots: a client asks it once."""
    topics = {f"/{robot}/component_status" for robot in robots}
    assert eventually(
        lambda: topics <= {one.topic for one in network.graph() if isinstance(one, EndpointEntity)}
    )


@contextmanager
def frames_on_bus() -> Iterator[tuple[Network, PublishedFrames]]:
    """Yield a network and the robot on it."""
    network = Network()
    try:
        frames = PublishedFrames(network.bus())
        try:
            await_announced(network, "robot")
            yield network, frames
        finally:
            frames.stop()
    finally:
        network.close()
