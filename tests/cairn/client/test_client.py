"""The client API, against a running deployment of small components."""

import gc
import itertools
import queue
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

import cairn.client
from cairn import CairnError
from cairn.bus.codec import Codec
from cairn.client import ControlError, NoMessageError, NoReplyError, Robot
from cairn.client.connection import Connection, Statuses
from cairn.client.velocity_gate import find_gate
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.geometry_msgs import PoseStamped, Twist, Vector3
from cairn.schemas.std_msgs import Header
from cairn.testing.launching import LIMIT_S, Run, launching, new_endpoint
from tests.wording import words_in_order

pytestmark = pytest.mark.processes

COMPONENTS = """
    components:
      listener: {plugin: test_listener}
      beacon: {plugin: test_beacon}
      talker: {plugin: test_talker}
    """


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with launching(tmp_path_factory.mktemp("rover")) as launch:
        run = launch(COMPONENTS, robot="rover")
        run.await_line("received 1,")
        yield run
        assert run.stop() == 0


@pytest.fixture
def robot(run: Run) -> Iterator[Robot]:
    with cairn.client.connect(run.endpoint) as robot:
        yield robot


def test_only_robot_needs_no_name(robot: Robot) -> None:
    assert robot.name == "rover"
    assert {"root", "listener", "beacon", "talker"} <= robot.components().keys()
    assert robot.components()["talker"].plugin == "test_talker"


def test_unknown_robot_is_reported_with_the_known_ones(run: Run) -> None:
    with (
        cairn.client.connect(run.endpoint, robot="tower") as robot,
        pytest.raises(CairnError, match=words_in_order("tower", "rover")),
    ):
        robot.components()


def test_without_a_router_connecting_fails_with_the_endpoint() -> None:
    endpoint = new_endpoint()
    with pytest.raises(CairnError, match=endpoint):
        cairn.client.connect(endpoint)


def test_topics_have_type_publishers_and_subscribers(robot: Robot) -> None:
    topics = {topic.name: topic for topic in robot.topics()}

    words = topics["/rover/words"]
    assert words.type_name == "geometry_msgs/msg/Twist"
    assert words.publishers == ("/rover/talker",)
    assert words.subscribers == ("/rover/listener",)


def test_subscription_yields_the_messages_in_order(robot: Robot) -> None:
    with robot.subscribe("words", Twist, timeout_s=LIMIT_S) as messages:
        numbers = [message.linear.x for message in itertools.islice(messages, 2)]

    assert numbers[1] == numbers[0] + 1


def test_callback_receives_the_messages_and_may_fail(robot: Robot) -> None:
    received: queue.Queue[Twist] = queue.Queue()

    def receive(message: Twist) -> None:
        received.put(message)
        raise RuntimeError("a callback that fails does not end its subscription")

    with robot.subscribe("words", Twist, receive):
        first, second = (received.get(timeout=LIMIT_S) for _ in range(2))

    assert second.linear.x > first.linear.x


def test_slow_reader_keeps_the_newest_messages(robot: Robot) -> None:
    with (
        robot.subscribe("words", Twist, depth=1) as slow,
        robot.subscribe("words", Twist) as fast,
    ):
        for _ in range(5):
            newest = fast.next(LIMIT_S)
        assert slow.next(LIMIT_S).linear.x >= newest.linear.x - 1
        assert slow.dropped >= 3


def test_latest_returns_a_latched_message_or_the_next_one(robot: Robot) -> None:
    assert robot.latest("beacon", PoseStamped).pose.position.x == 4.0
    assert robot.latest("words", Twist, timeout_s=LIMIT_S).linear.x > 0


def test_silent_topic_ends_the_wait_with_the_limit(robot: Robot) -> None:
    with (
        robot.subscribe("silence", Twist) as messages,
        pytest.raises(NoMessageError, match=r"/rover/silence: no message within 0\.1 s"),
    ):
        messages.next(0.1)


def test_closed_subscription_is_reported_as_closed(robot: Robot) -> None:
    with robot.subscribe("words", Twist, timeout_s=LIMIT_S) as messages:
        messages.next()

    with pytest.raises(NoMessageError, match="/rover/words: the subscription is closed"):
        messages.next()


class OneMessage:
    """A connection to a bus on which each subscriber receives one message."""

    domain = 0

    def endpoints(self, _topic: str) -> list[Any]:
        return []

    def subscriber(self, _key: str, handler: Any, *, latched: bool) -> Any:
        data = Codec().encode(Twist(linear=Vector3(x=1.0)))
        handler(SimpleNamespace(payload=SimpleNamespace(to_bytes=lambda: data)))
        return SimpleNamespace(undeclare=lambda: None)

    def close(self) -> None: ...


def test_closed_subscription_and_its_messages_are_released() -> None:
    robot = Robot(cast("Connection", OneMessage()))
    with robot.subscribe("/rover/words", Twist) as messages:
        assert messages.next(LIMIT_S) == Twist(linear=Vector3(x=1.0))
    with robot.subscribe("/rover/words", Twist) as unread:
        pass

    with pytest.raises(NoMessageError):  # not the message from before
        unread.next(LIMIT_S)
    closed = weakref.ref(messages)
    del messages
    gc.collect()
    assert closed() is None


def test_another_message_type_is_rejected_with_the_type_in_use(robot: Robot) -> None:
    with pytest.raises(CairnError, match="geometry_msgs/msg/Twist"):
        robot.subscribe("words", PoseStamped)


def test_published_message_reaches_every_subscriber(robot: Robot) -> None:
    with robot.subscribe("words", Twist, timeout_s=LIMIT_S) as messages:
        assert robot.publish("words", Twist(linear=Vector3(x=-1.0))) == "/rover/words"
        assert any(message.linear.x == -1.0 for message in messages)


def test_message_without_a_subscriber_is_rejected(robot: Robot) -> None:
    with pytest.raises(CairnError, match="nothing subscribes to it with geometry_msgs/msg/Twist"):
        robot.publish("nowhere", Twist())


def test_parameters_are_read_and_set_or_rejected(robot: Robot) -> None:
    robot.set_parameters("talker", {"volume": 6})

    volume = robot.parameters("talker")["volume"]
    assert (volume.value, volume.bounds) == (6, ">= 0, <= 11")
    with pytest.raises(ControlError, match="volume = 12"):
        robot.set_parameters("talker", {"volume": 12})


def test_requests_to_missing_components_fail_with_the_known_names(robot: Robot) -> None:
    with pytest.raises(CairnError, match=r"no tower on the bus.*talker"):
        robot.request("tower", "parameters")
    with pytest.raises(NoReplyError, match="/rover/tower"):
        robot.connection.request("/rover/tower", "parameters", timeout_s=5.0)


def test_logs_are_those_of_one_component_in_order(robot: Robot) -> None:
    entries = robot.logs("listener")

    assert {entry.name for entry in entries} == {"rover.listener"}
    stamps = [(entry.stamp.sec, entry.stamp.nanosec) for entry in entries]
    assert stamps == sorted(stamps)


def test_component_is_restarted(robot: Robot) -> None:
    before = robot.components()["beacon"].pid

    assert robot.restart("beacon") == "active"
    assert robot.components()["beacon"].pid != before
    with pytest.raises(CairnError, match=r"no tower on the bus.*/rover/beacon"):
        robot.restart("tower")


def test_full_name_unloads_and_loads_a_component(robot: Robot) -> None:
    assert robot.unload("/rover/beacon") == "unloaded"
    assert robot.load("/rover/beacon") == "active"


def test_goal_without_a_supervisor_that_accepts_it_fails_with_the_remedy(robot: Robot) -> None:
    with pytest.raises(CairnError, match=r"no mobile_supervisor runs here.*cairn up sim"):
        robot.go(1.0, 2.0)


BUSY = Statuses({}, {}, 0, incomplete=True)


def test_supervisor_that_a_busy_router_does_not_list_at_once_is_found(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor = ComponentStatus(
        Header(), "mobile_supervisor", plugin="mobile_supervisor", state="active"
    )
    heard = replace(BUSY, answered={"/rover/mobile_supervisor": supervisor})
    answers = [BUSY, heard]
    monkeypatch.setattr(Connection, "read_statuses", lambda *_, **__: answers.pop(0))

    robot.missions()

    assert answers == []


@pytest.mark.parametrize(
    "call",
    [Robot.missions, lambda robot: find_gate(robot, ""), lambda robot: robot.component_of("slam")],
)
def test_router_that_stays_too_busy_to_list_components_is_reported_as_such(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, call: Callable[[Robot], object]
) -> None:
    monkeypatch.setattr(Connection, "read_statuses", lambda *_, **__: BUSY)
    monkeypatch.setattr("cairn.client.connection._LISTING_LIMIT_S", 0.0)

    with pytest.raises(CairnError, match=r"cannot be listed within .* try again"):
        call(robot)
