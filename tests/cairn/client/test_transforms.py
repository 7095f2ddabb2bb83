"""Transforms in scripts: a listener that fills a buffer, on a bus of its own."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

import cairn.client
from cairn import LATCHED, RELIABLE, SECOND, CairnError, from_ns
from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.client import Connection, Robot
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.tf2_msgs import TFMessage
from cairn.tf import ExtrapolationError, Transform, UnknownFrameError
from tests.cairn.bus.network import Network, eventually
from tests.patience import LIMIT_S
from tests.wording import assert_words, words_in_order

from .published_frames import PublishedFrames, await_announced, frames_on_bus, stamped

pytestmark = pytest.mark.processes

Setting = tuple[Network, PublishedFrames]


@pytest.fixture(scope="module")
def setting() -> Iterator[Setting]:
    with frames_on_bus() as setting:
        yield setting


@pytest.fixture
def robot(setting: Setting) -> Iterator[Robot]:
    with cairn.client.connect(setting[0].endpoint) as robot:
        yield robot


@pytest.fixture
def network() -> Iterator[Network]:
    """A bus without a robot."""
    network = Network()
    try:
        yield network
    finally:
        network.close()


def test_lookup_waits_for_transforms_and_finds_latched_ones(robot: Robot) -> None:
    with robot.transforms() as transforms:
        found = transforms.lookup("map", "laser", timeout_s=LIMIT_S)

        assert transforms.topics == ("/tf", "/tf_static", "/robot/tf", "/robot/tf_static")
        wanted = (1 + 3.1 * math.cos(0.5), 2 + 3.1 * math.sin(0.5), 0.2)
        assert found.translation == pytest.approx(wanted)
        newest = transforms.buffer.newest_common_time("map", "laser")
        assert newest is not None
        later = newest + SECOND // 10
        assert transforms.lookup("odom", "base_link", later, timeout_s=LIMIT_S)


def test_frames_have_the_names_of_their_publishers(robot: Robot) -> None:
    transforms = robot.transforms()
    transforms.lookup("map", "laser", timeout_s=LIMIT_S)
    wanted = {
        "map": "",
        "odom": "/robot/localizer",
        "base_link": "/robot/base",
        "laser": "/robot/robot_frames",
    }

    def publishers() -> dict[str, str]:
        return {name: one.publisher for name, one in transforms.buffer.frames().items()}

    assert eventually(lambda: publishers() == wanted), publishers()


def test_static_transform_of_a_later_publisher_arrives(robot: Robot, setting: Setting) -> None:
    transforms = robot.transforms()
    transforms.await_transforms(LIMIT_S)

    arm = stamped(0, "base_link", "arm", Transform((0.0, 0.0, 1.0)))
    setting[1].publisher("arm", static=True).publish(TFMessage(transforms=(arm,)))

    assert transforms.lookup("laser", "arm", timeout_s=LIMIT_S).translation[2] == 0.8


def test_static_transforms_arrive_in_each_of_two_ways(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    # One finds publishers that start later; the other does not wait for a process that is stopped.
    subscribe = Connection.subscriber

    @contextmanager
    def deaf(_self: Connection, _key: str, **_settings: object) -> Iterator[None]:
        yield

    def not_latched(self: Connection, key: str, handler: object, *, latched: bool) -> object:
        return (
            SimpleNamespace(undeclare=int)
            if latched
            else subscribe(self, key, handler, latched=False)
        )

    for method, without in (("listen", deaf), ("subscriber", not_latched)):
        with monkeypatch.context() as patch:
            patch.setattr(Connection, method, without)
            found = robot.transforms().lookup("base_link", "laser", timeout_s=LIMIT_S)
        assert found.translation == (0.1, 0.0, 0.2)


def test_closed_listener_keeps_nothing_that_is_published(robot: Robot) -> None:
    ended = robot.transforms()
    ended.lookup("map", "laser", timeout_s=LIMIT_S)
    ended.close()
    other = robot.transforms()
    other.lookup("map", "laser", timeout_s=LIMIT_S)
    newest = other.buffer.frames()["base_link"].newest_ns
    assert newest is not None
    # What was under way at the end may still be put in.
    other.lookup("odom", "base_link", newest + SECOND // 10, timeout_s=LIMIT_S)
    waiting = ended._samples.qsize()

    other.lookup("odom", "base_link", newest + SECOND // 4, timeout_s=LIMIT_S)

    assert ended._samples.qsize() == waiting


def test_unknown_frame_is_reported_after_the_time_limit(robot: Robot) -> None:
    transforms = robot.transforms()
    transforms.lookup("map", "laser", timeout_s=LIMIT_S)

    with pytest.raises(UnknownFrameError, match=words_in_order("lasr", "did you mean laser")):
        transforms.lookup("map", "lasr", timeout_s=0.05)


def test_time_before_the_oldest_transform_is_not_waited_for(robot: Robot) -> None:
    transforms = robot.transforms()
    transforms.lookup("map", "laser", timeout_s=LIMIT_S)

    with pytest.raises(ExtrapolationError, match="oldest"):
        transforms.lookup("map", "laser", 5 * SECOND, timeout_s=math.inf)


def test_second_parent_is_reported_with_the_publishers(robot: Robot, setting: Setting) -> None:
    problems: list[str] = []
    transforms = robot.transforms(on_problem=problems.append)
    transforms.lookup("map", "laser", timeout_s=LIMIT_S)
    rival = setting[1].publisher("rival")

    def publish() -> bool:
        now = time.time_ns()
        message = TFMessage(transforms=(stamped(now, "map", "base_link", Transform()),))
        rival.publish(message)
        return bool(problems)

    assert eventually(publish)
    assert_words(problems[0], "base_link", "odom", "map", "newest transform counts")


def test_closed_robot_ends_its_listeners(robot: Robot, setting: Setting) -> None:
    going_on = robot.transforms()
    going_on.lookup("map", "laser", timeout_s=LIMIT_S)
    with cairn.client.connect(setting[0].endpoint) as other:
        ended = other.transforms()
        ended.lookup("map", "laser", timeout_s=LIMIT_S)
    newest = ended.buffer.frames()["base_link"].newest_ns
    assert newest is not None

    going_on.lookup("odom", "base_link", newest + SECOND // 10, timeout_s=LIMIT_S)

    assert ended.buffer.frames()["base_link"].newest_ns == newest
    with pytest.raises(UnknownFrameError, match="moon"):
        ended.lookup("map", "moon", timeout_s=LIMIT_S)  # it does not wait
    ended.close()  # a second time, without effect


def test_silence_is_reported_with_the_topics(network: Network) -> None:
    bus = network.bus()
    node = bus.node("/rover/base", print)
    node.advertise("/rover/component_status", ComponentStatus, LATCHED)
    await_announced(network, "rover")

    with cairn.client.connect(network.endpoint) as robot:
        transforms = robot.transforms()
        wanted = words_in_order("no transform within 0.05 s", "/tf", "/rover/tf_static", "start")
        with pytest.raises(CairnError, match=wanted):
            transforms.await_transforms(0.05)
        with pytest.raises(CairnError, match=wanted):
            transforms.lookup("map", "laser", timeout_s=0.05)


def test_without_a_robot_of_cairn_the_topics_of_ros_are_read(network: Network) -> None:
    node = network.bus().node("/robot_state_publisher", print)
    static = node.advertise("/tf_static", TFMessage, LATCHED)
    static.publish(TFMessage(transforms=(stamped(0, "base", "arm", Transform((1.0, 0.0, 0.0))),)))

    with cairn.client.connect(network.endpoint) as robot:
        transforms = robot.transforms()

        assert transforms.topics == ("/tf", "/tf_static")
        assert transforms.lookup("base", "arm", timeout_s=LIMIT_S).translation[0] == 1.0


def test_among_several_robots_one_must_be_named(network: Network) -> None:
    bus = network.bus()
    for number, name in enumerate(("ada", "bob")):
        node = bus.node(f"/{name}/base", print)
        node.advertise(f"/{name}/component_status", ComponentStatus, LATCHED)
        static = node.advertise(f"/{name}/tf_static", TFMessage, LATCHED)
        laser = stamped(0, "base", "laser", Transform((float(number), 0.0, 0.0)))
        static.publish(TFMessage(transforms=(laser,)))
    await_announced(network, "ada", "bob")

    with (
        cairn.client.connect(network.endpoint) as either,
        pytest.raises(CairnError, match=words_in_order("ada, bob", "--robot")),
    ):
        either.transforms()
    with cairn.client.connect(network.endpoint, robot="bob") as bob:
        found = bob.transforms().lookup("base", "laser", timeout_s=LIMIT_S)
        assert found.translation[0] == 1.0


def test_clock_is_the_time_and_set_back_it_clears_the_buffer(network: Network) -> None:
    node = network.bus().node("/rover/base", print)
    node.advertise("/rover/component_status", ComponentStatus, LATCHED)
    clock = node.advertise("/rover/clock", Clock, RELIABLE)
    tf = node.advertise("/rover/tf", TFMessage, RELIABLE)
    static = node.advertise("/rover/tf_static", TFMessage, LATCHED)
    static.publish(TFMessage(transforms=(stamped(0, "base", "laser", Transform()),)))
    await_announced(network, "rover")

    def show(seconds: float) -> None:
        now = round(seconds * SECOND)
        clock.publish(Clock(clock=from_ns(now)))
        tf.publish(TFMessage(transforms=(stamped(now, "odom", "base", Transform()),)))

    with cairn.client.connect(network.endpoint) as robot:
        transforms = robot.transforms()
        assert abs(transforms.now_ns() - time.time_ns()) < 3600 * SECOND

        def newest() -> int | None:
            base = transforms.buffer.frames().get("base")
            return base.newest_ns if base else None

        def shown(seconds: float) -> bool:
            show(seconds)
            return (transforms.now_ns(), newest()) == (round(seconds * SECOND),) * 2

        assert eventually(lambda: shown(100.0))
        assert eventually(lambda: shown(2.0))  # more than the length of the buffer before
        assert transforms.lookup("odom", "laser", timeout_s=LIMIT_S)


def test_clock_of_the_robot_counts_before_that_of_ros(network: Network) -> None:
    node = network.bus().node("/rover/base", print)
    node.advertise("/rover/component_status", ComponentStatus, LATCHED)
    static = node.advertise("/rover/tf_static", TFMessage, LATCHED)
    clocks = {topic: node.advertise(topic, Clock, RELIABLE) for topic in ("/clock", "/rover/clock")}
    await_announced(network, "rover")

    with cairn.client.connect(network.endpoint) as robot:
        transforms = robot.transforms()

        def shown(topic: str, seconds: int) -> bool:
            clocks[topic].publish(Clock(clock=from_ns(seconds * SECOND)))
            return transforms.now_ns() == seconds * SECOND

        assert eventually(lambda: shown("/clock", 9))
        assert eventually(lambda: shown("/rover/clock", 5))
        clocks["/clock"].publish(Clock(clock=from_ns(100 * SECOND)))
        later = stamped(0, "base", "later", Transform())
        static.publish(TFMessage(transforms=(later,)))
        transforms.lookup("base", "later", timeout_s=LIMIT_S)  # it arrives after the clock
        assert transforms.now_ns() == 5 * SECOND


def test_transforms_that_are_repeated_under_names_of_ros_count_once(
    robot: Robot, setting: Setting
) -> None:
    """A deployment with `ros_names` publishes them on `/tf`, too."""
    transforms = robot.transforms()
    transforms.lookup("map", "laser", timeout_s=LIMIT_S)
    repeater = setting[0].bus().node("/robot/ros_names", print)
    other = setting[0].bus().node("/ros/driver", print)
    moved = TFMessage(transforms=(stamped(0, "base_link", "laser", Transform((9.0, 0.0, 0.0))),))
    repeated = repeater.advertise("/tf_static", TFMessage, LATCHED)
    repeated.publish(moved)
    sign = TFMessage(transforms=(stamped(0, "base_link", "sign", Transform()),))
    signs = other.advertise("/tf_static", TFMessage, LATCHED)
    signs.publish(sign)

    transforms.lookup("base_link", "sign", timeout_s=LIMIT_S)

    assert transforms.lookup("base_link", "laser").translation[0] == 0.1


def test_message_that_is_not_valid_does_not_end_the_listener(
    robot: Robot, setting: Setting
) -> None:
    transforms = robot.transforms()
    transforms.lookup("odom", "base_link", timeout_s=LIMIT_S)
    for topic in ("/robot/tf", "/robot/tf_static"):
        key = keys.message_key(0, topic, TFMessage)
        setting[0].router.session.put(key, b"no CDR")
        moon = TFMessage(transforms=(stamped(1, "map", "moon", Transform()),))
        setting[0].router.session.put("0/robot/**", Codec().encode(moon))
        setting[0].router.session.put(key, bytes(4 << 20), attachment=b"no attachment")
    newest = transforms.buffer.newest_common_time("odom", "base_link")
    assert newest is not None

    assert transforms.lookup("odom", "base_link", newest + SECOND // 5, timeout_s=LIMIT_S)
    assert "moon" not in transforms.buffer.frames()
