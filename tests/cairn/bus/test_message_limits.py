"""Limits on the length of messages: their defaults, and what the transport lets through."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
import zenoh

from cairn import RELIABLE
from cairn.bus.codec import Codec
from cairn.bus.keys import message_key
from cairn.bus.message_limits import (
    MAX_MESSAGE_SIZE,
    MessageLimits,
    PublisherLog,
    default_max_bytes,
    is_bulk,
    length_of,
    ring_length,
)
from cairn.schemas.cairn_msgs import ComponentStatus, PortStatus
from cairn.schemas.geometry_msgs import Pose, PoseArray, TransformStamped, Twist
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry, Path
from cairn.schemas.packed import Packed
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import Image, LaserScan
from cairn.schemas.std_msgs import Header, String
from cairn.schemas.tf2_msgs import TFMessage
from tests.cairn.bus.network import SECRET, Network, eventually, node
from tests.patience import LIMIT_S


@pytest.mark.parametrize(
    ("message", "limit"),
    [
        (Twist, 4 << 10),
        (Odometry, 4 << 10),
        (String, 64 << 10),
        (LaserScan, 1 << 20),
        (Path, 1 << 20),
        (PoseArray, 1 << 20),
        (OccupancyGrid, MAX_MESSAGE_SIZE),
        (Image, MAX_MESSAGE_SIZE),
    ],
)
def test_default_limit_follows_from_the_type(message: type, limit: int) -> None:
    assert default_max_bytes(message) == limit


def test_images_maps_and_particles_are_bulk_messages() -> None:
    bulk = {cls for cls in (Image, OccupancyGrid, PoseArray) if is_bulk(cls)}
    assert bulk == {Image, OccupancyGrid, PoseArray}
    assert not any(is_bulk(cls) for cls in (LaserScan, Twist, TFMessage, Path, Clock))


@pytest.mark.parametrize(
    "message",
    [
        Twist(),
        Header(frame_id="map"),
        Odometry(),
        Image(height=1, step=700, data=np.zeros(700, np.uint8)),
        PoseArray(poses=Packed(Pose, [Pose()] * 3)),
        TFMessage(transforms=(TransformStamped(child_frame_id="base"),) * 3),
        ComponentStatus(
            header=Header(),
            component="base",
            children=("a", "bcd"),
            ports=(PortStatus(port="x", topic="/x", direction=PortStatus.IN),) * 4,
        ),
    ],
    ids=lambda message: type(message).__name__,
)
def test_length_of_a_message_is_that_of_its_encoding_but_for_padding(message: Any) -> None:
    encoded = len(Codec().encode(message))
    assert 0.8 * encoded - 8 < length_of(message) <= encoded


@pytest.mark.parametrize(
    ("depth", "limit", "length"),
    [
        (5, 1 << 20, 5),
        (1000, 4 << 10, 1000),
        (200, 1 << 20, 32),
        (50, 32 << 20, 4),
        (1, 1 << 30, 1),
    ],
)
def test_ring_is_bounded_by_its_bytes(depth: int, limit: int, length: int) -> None:
    assert ring_length(depth, limit) == length


def test_publisher_may_send_what_the_transport_accepts() -> None:
    limits = MessageLimits(max_message_size=1 << 20, topics={"/robot/scan": 4096})

    assert limits.of("/robot/scan") == 4096
    assert (1 << 20) - 4096 < limits.of("/robot/other") < 1 << 20


def test_each_publisher_is_reported_ever_more_rarely() -> None:
    reports: list[str] = []
    log = PublisherLog(reports.append)

    for _ in range(9):
        log.add("/robot/camera", lambda named: f"too long: {named}")
    log.add("/robot/scanner", lambda named: f"too long: {named}")

    assert reports[0] == "too long: /robot/camera"
    assert ["(8 from there so far, suppressed 3)" in report for report in reports] == [
        False, False, False, True, False,
    ]  # fmt: skip
    assert reports[-1] == "too long: /robot/scanner"


def test_publishers_without_end_do_not_fill_log_and_memory() -> None:
    reports: list[str] = []
    log = PublisherLog(reports.append)

    for number in range(10_000):
        log.add(f"/robot/ghost_{number}", lambda named: named)

    assert len(reports) < 40


_READER = """
import sys, threading
from cairn import RELIABLE
from cairn.bus.message_limits import MessageLimits
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import String

limits = MessageLimits(topics={"/robot/scan": 4 << 20})
bus = ZenohBus(open_peer([sys.argv[1]], limits=limits, secret=sys.argv[2]), 0, sys.argv[2], limits)
node = bus.node("/robot/localizer", lambda problem: None)
entered, done = threading.Event(), threading.Event()

def handle_for_long():
    entered.set()
    done.wait()

def resident_mb(name):
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) for line in status if line.startswith(name)) // 1024

scan = node.subscribe("/robot/scan", LaserScan, RELIABLE, handle_for_long)
end = node.subscribe("/robot/end", String, RELIABLE, done.set)
bus.wait_for_peers(10.0)
print("ready", flush=True)
entered.wait()
before = resident_mb("VmRSS")
print("busy", flush=True)
done.wait()
print(resident_mb("VmHWM") - before, flush=True)
bus.close()
"""


@pytest.mark.accuracy
@pytest.mark.processes
def test_long_messages_do_not_fill_the_memory_of_a_busy_reader(network: Network) -> None:
    program = [sys.executable, "-c", _READER, network.endpoint, SECRET]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as reader:
        assert reader.stdout is not None
        try:
            assert reader.stdout.readline() == "ready\n"
            bus = network.bus()
            assert bus.wait_for_peers(LIMIT_S) == []
            key = message_key(0, "/robot/scan", LaserScan)

            def send(payload: bytes) -> None:
                block = zenoh.CongestionControl.BLOCK
                bus.session.put(key, payload, congestion_control=block)

            send(b"the handler of this message lasts until the end")
            assert reader.stdout.readline() == "busy\n"
            for payload in [bytes(30_000_000)] * 8 + [bytes(80_000_000)]:
                send(payload)
            word = node(bus, "/robot/talker").advertise("/robot/end", String, RELIABLE)
            assert eventually(lambda: word.has_subscribers)
            word.publish(String(data="end"))
            grown_mb = int(reader.stdout.readline())
        finally:
            reader.kill()
    # Two messages may be assembled at the same time; eight would fill the ring.
    assert grown_mb < 120, f"{grown_mb} MB"
