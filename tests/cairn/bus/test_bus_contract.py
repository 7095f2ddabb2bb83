"""The contract of every bus: Zenoh between processes, Zenoh within one, and lockstep."""

import threading
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, dataclass

import pytest

from cairn import LATCHED, RELIABLE, SENSOR, Qos
from cairn.bus import lockstep_bus, zenoh_bus
from cairn.bus.bus import Bus
from cairn.bus.conflicts import type_conflict
from cairn.bus.exclusive import Exclusive
from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import String
from tests.cairn.bus.network import Network, Reader, eventually, node
from tests.patience import LIMIT_S
from tests.wording import assert_words

TOPIC = "/robot/word"


@dataclass
class Pair:
    """The bus of the publisher and that of the subscriber."""

    writers: Bus
    readers: Bus

    def wait_for_peers(self) -> None:
        """Wait until no message between the two can be lost."""
        assert self.writers.wait_for_peers(LIMIT_S) == []
        assert self.readers.wait_for_peers(LIMIT_S) == []


@pytest.fixture(params=["two processes", "one process", "lockstep"])
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    if request.param == "lockstep":
        memory = LockstepBus()
        yield Pair(memory, memory)
        return
    network = Network()
    try:
        bus = network.bus()
        yield Pair(bus, bus if request.param == "one process" else network.bus())
    finally:
        network.close()


def await_publisher(bus: Bus, name: str) -> None:
    """Wait until the bus knows from the graph which node publishes; it knows so from then on."""
    if isinstance(bus, ZenohBus):
        known: list[str] = []
        bus.graph.watch(TOPIC, lambda endpoint: known.append(endpoint.node.name))
        assert eventually(lambda: name in known)


def words(*numbers: int) -> list[String]:
    return [String(data=str(number)) for number in numbers]


@pytest.mark.parametrize("qos", [RELIABLE, SENSOR, LATCHED], ids=["reliable", "sensor", "latched"])
def test_messages_arrive_in_order(pair: Pair, qos: Qos) -> None:
    reader = Reader(node(pair.readers, "/robot/listener"), TOPIC, String, qos.with_depth(200))
    writer = node(pair.writers, "/robot/talker").advertise(TOPIC, String, qos)
    pair.wait_for_peers()

    for word in words(*range(200)):
        writer.publish(word)

    assert reader.next_of(200) == words(*range(200))
    assert (reader.subscription.received, reader.subscription.dropped) == (200, 0)
    assert writer.published == 200


def test_two_publishers_reach_two_subscriptions(pair: Pair) -> None:
    listener, talker = node(pair.readers, "/robot/listener"), node(pair.writers, "/robot/talker")
    readers = [Reader(listener, TOPIC, String, RELIABLE) for _ in range(2)]
    writers = [talker.advertise(TOPIC, String, RELIABLE) for _ in range(2)]
    pair.wait_for_peers()

    for writer, word in zip(writers, words(1, 2), strict=True):
        writer.publish(word)

    for reader in readers:
        assert sorted(word.data for word in reader.next_of(2)) == ["1", "2"]
        assert reader.subscription.dropped == 0


@pytest.mark.parametrize(
    ("kept", "requested", "received_count"), [(1, 1, 1), (5, 5, 5), (5, 2, 2), (2, 5, 2)]
)
def test_late_subscriber_receives_latched_messages(
    pair: Pair, kept: int, requested: int, received_count: int
) -> None:
    writer = node(pair.writers, "/robot/talker").advertise(TOPIC, String, LATCHED.with_depth(kept))
    for word in words(*range(9)):
        writer.publish(word)
    pair.wait_for_peers()

    reader = Reader(
        node(pair.readers, "/robot/listener"), TOPIC, String, LATCHED.with_depth(requested)
    )

    assert reader.next_of(received_count) == words(*range(9 - received_count, 9))
    pair.wait_for_peers()
    writer.publish(String(data="then"))
    assert reader.next() == String(data="then")
    assert reader.subscription.dropped == 0


@pytest.mark.parametrize(
    ("writes", "reads"), [(RELIABLE, RELIABLE), (LATCHED, RELIABLE), (RELIABLE, LATCHED)]
)
def test_late_subscriber_of_a_volatile_topic_receives_only_new_messages(
    pair: Pair, writes: Qos, reads: Qos
) -> None:
    early = Reader(node(pair.readers, "/robot/early"), TOPIC, String, RELIABLE)
    writer = node(pair.writers, "/robot/talker").advertise(TOPIC, String, writes)
    pair.wait_for_peers()
    writer.publish(String(data="before"))
    assert early.next() == String(data="before")

    problems: list[str] = []
    late = Reader(pair.readers.node("/robot/late", problems.append), TOPIC, String, reads)
    pair.wait_for_peers()
    writer.publish(String(data="after"))

    assert late.next() == String(data="after")
    assert late.subscription.dropped == 0
    # Over Zenoh a mismatch is reported, sooner or later: it gets none from before its start.
    assert reads == LATCHED or problems == []


def test_latched_messages_end_with_their_publisher(pair: Pair) -> None:
    talker = node(pair.writers, "/robot/talker")
    first = talker.advertise(TOPIC, String, LATCHED)
    first.publish(String(data="old"))
    first.close()
    second = talker.advertise(TOPIC, String, LATCHED)
    pair.wait_for_peers()

    reader = Reader(node(pair.readers, "/robot/listener"), TOPIC, String, LATCHED)
    pair.wait_for_peers()
    second.publish(String(data="new"))

    assert reader.next() == String(data="new")


@pytest.mark.parametrize("depth", [1, 10])
def test_slow_subscriber_keeps_the_newest_and_counts_the_dropped(pair: Pair, depth: int) -> None:
    slow = Reader(node(pair.readers, "/robot/listener"), TOPIC, String, RELIABLE.with_depth(depth))
    writer = node(pair.writers, "/robot/talker").advertise(TOPIC, String, RELIABLE)
    pair.wait_for_peers()
    writer.publish(String(data="0"))
    slow.await_first()

    # Few enough for one batch of Zenoh's: a publisher drops messages if the link stalls.
    for word in words(*range(1, 200)):
        writer.publish(word)

    assert eventually(lambda: slow.subscription.dropped == 200 - depth)
    assert slow.pending() == words(*range(200 - depth, 200))
    writer.publish(String(data="next"))
    assert eventually(lambda: slow.pending() == [String(data="next")])
    assert (slow.subscription.received, slow.subscription.dropped) == (depth + 1, 200 - depth)


def test_every_pending_message_wakes_the_subscriber_in_any_race(pair: Pair) -> None:
    reader = Reader(node(pair.readers, "/robot/listener"), TOPIC, String, RELIABLE.with_depth(1))
    writer = node(pair.writers, "/robot/talker").advertise(TOPIC, String, RELIABLE)
    pair.wait_for_peers()
    ends = threading.Event()
    texts: list[str] = []

    def read() -> None:
        while not ends.is_set():
            word = reader.next()
            texts.append(word.data if word is not None else "")
            if texts[-1] == "last":
                ends.set()

    thread = threading.Thread(target=read)
    thread.start()
    for word in words(*range(2000)):
        writer.publish(word)

    def publish_last() -> bool:
        # Again and again, because a publisher drops messages if the link stalls. A message that is
        # pending without a wake-up stays so: those that replace it do not wake the subscriber.
        writer.publish(String(data="last"))
        return ends.is_set()

    assert eventually(publish_last), "the last message is pending without a wake-up"
    thread.join()
    received = [int(word) for word in texts[:-1] if word]
    assert received == sorted(received)


def test_two_types_on_one_topic_are_reported_to_both_nodes(pair: Pair) -> None:
    talker_problems: list[str] = []
    listener_problems: list[str] = []
    talker = pair.writers.node("/robot/talker", talker_problems.append)
    listener = pair.readers.node("/robot/listener", listener_problems.append)
    writer = talker.advertise(TOPIC, String, RELIABLE)
    subscription = listener.subscribe(TOPIC, Twist, RELIABLE, lambda: None)
    pair.wait_for_peers()

    writer.publish(String(data="lost"))

    string, twist = "std_msgs/msg/String", "geometry_msgs/msg/Twist"
    talks, listens = ("/robot/talker", string), ("/robot/listener", twist)
    assert eventually(lambda: talker_problems == [type_conflict(TOPIC, *listens, *talks)])
    assert eventually(lambda: listener_problems == [type_conflict(TOPIC, *talks, *listens)])
    assert all(part in listener_problems[0] for part in (TOPIC, "/robot/talker", string, twist))
    assert subscription.take() is None


@pytest.mark.parametrize("qos", [RELIABLE, LATCHED], ids=["volatile", "latched"])
def test_exclusive_subscription_receives_only_from_the_entitled_writer(
    pair: Pair, qos: Qos
) -> None:
    entitled = Exclusive("/robot/gate", bytes(range(32)))
    gate = node(pair.writers, "/robot/gate").advertise(TOPIC, String, qos, entitled)
    intruder = node(pair.writers, "/robot/intruder").advertise(TOPIC, String, qos)
    await_publisher(pair.readers, "/robot/intruder")
    intruder.publish(String(data="forged"))
    gate.publish(String(data="first"))
    problems: list[str] = []
    reader = Reader(pair.readers.node("/robot/base", problems.append), TOPIC, String, qos, entitled)
    other = Reader(node(pair.readers, "/robot/view"), TOPIC, String, qos.with_depth(100))
    pair.wait_for_peers()
    if qos.latched:
        assert reader.next() == String(data="first")

    for word in words(*range(9)):
        intruder.publish(String(data="forged"))
        gate.publish(word)
        assert reader.next() == word

    assert "/robot/intruder" in problems[0]
    assert "/robot/gate" in problems[0]
    assert TOPIC in problems[0]
    refused = 10 if qos.latched else 9
    assert eventually(lambda: reader.subscription.refused == refused)
    assert len(problems) == 4, "the 1st, 2nd, 4th and 8th are reported"
    assert reader.subscription.dropped == 0
    seen: list[String] = []

    def sees_all_forged() -> bool:
        seen.extend(other.pending())
        return seen.count(String(data="forged")) == refused

    assert eventually(sees_all_forged)


def test_closing_twice_is_harmless_and_ends_delivery(pair: Pair) -> None:
    talker, listener = node(pair.writers, "/robot/talker"), node(pair.readers, "/robot/listener")
    closed = Reader(listener, TOPIC, String, RELIABLE)
    other = Reader(listener, TOPIC, String, RELIABLE)
    writer = talker.advertise(TOPIC, String, RELIABLE)
    closing = talker.advertise(TOPIC, String, RELIABLE)
    pair.wait_for_peers()
    closed.subscription.close()
    closing.close()

    closing.publish(String(data="closed"))
    writer.publish(String(data="open"))

    assert other.next() == String(data="open")
    assert closed.subscription.take() is None
    for _ in range(2):
        closing.close()
        closed.subscription.close()
        talker.close()
        listener.close()
    assert other.pending() == []


def test_closing_stops_all_threads() -> None:
    before = set(threading.enumerate())
    network = Network()
    buses = [network.bus(), network.bus()]
    for number, bus in enumerate(buses):
        component = node(bus, f"/robot/part_{number}")
        for topic, qos in ((TOPIC, RELIABLE), ("/robot/kept", LATCHED)):
            Reader(component, topic, String, qos)
            component.advertise(topic, String, qos)
        bus.wait_for_peers(LIMIT_S)
        component.close()
    for bus in buses * 2:
        bus.close()
    network.close()

    assert eventually(lambda: set(threading.enumerate()) <= before)


def test_received_message_is_immutable(pair: Pair) -> None:
    reader = Reader(node(pair.readers, "/robot/listener"), "/robot/scan", LaserScan, SENSOR)
    writer = node(pair.writers, "/robot/laser").advertise("/robot/scan", LaserScan, SENSOR)
    pair.wait_for_peers()

    writer.publish(
        LaserScan(angle_max=0.1, angle_increment=0.1, range_max=5.0, ranges=[1.0, 2.0])  # type: ignore[arg-type]
    )

    scan = reader.next()
    with pytest.raises(FrozenInstanceError):
        scan.range_max = 9.0
    with pytest.raises(ValueError, match="read-only"):
        scan.ranges[0] = 9.0


def test_publishing_without_subscriber_does_not_encode_the_message(pair: Pair) -> None:
    writer = node(pair.writers, "/robot/talker").advertise(TOPIC, String, RELIABLE)
    pair.wait_for_peers()

    writer.publish(object())

    assert writer.published == 1


def test_first_message_to_a_subscriber_counts_no_drops(pair: Pair) -> None:
    writer = node(pair.writers, "/robot/talker").advertise("/robot/speed", Twist, RELIABLE)
    early = Reader(node(pair.readers, "/robot/early"), "/robot/speed", Twist, RELIABLE)
    pair.wait_for_peers()
    for _ in range(5):
        writer.publish(Twist())
    early.next_of(5)

    late = Reader(node(pair.readers, "/robot/late"), "/robot/speed", Twist, RELIABLE)
    pair.wait_for_peers()
    writer.publish(Twist(linear=Vector3(x=0.5)))

    assert late.next().linear.x == 0.5
    assert late.subscription.dropped == 0


def test_too_long_message_is_rejected_counted_and_reported_with_its_publisher(pair: Pair) -> None:
    problems: list[str] = []
    arrived = threading.Semaphore(0)
    subscription = pair.readers.node("/robot/listener", problems.append).subscribe(
        TOPIC, String, RELIABLE, arrived.release, max_bytes=100
    )
    writer = node(pair.writers, "/robot/talker").advertise(TOPIC, String, RELIABLE)
    pair.wait_for_peers()
    await_publisher(pair.readers, "/robot/talker")

    for length in (10, 1_000, 2_000, 20):
        writer.publish(String(data="x" * length))

    for length in (10, 20):
        assert arrived.acquire(timeout=LIMIT_S)
        word = subscription.take()
        assert word is not None
        assert len(word.data) == length
    assert not arrived.acquire(blocking=False)
    assert (subscription.invalid, subscription.received, subscription.dropped) == (2, 2, 0)
    assert len(problems) == 2
    assert_words(problems[0], "1,009 bytes", TOPIC, "/robot/talker", "100", "max_bytes")


def test_pending_messages_are_bounded_by_their_bytes(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    for bus in (lockstep_bus, zenoh_bus):
        monkeypatch.setattr(bus, "PENDING_BYTES", 50_000)
    reader = Reader(node(pair.readers, "/robot/listener"), TOPIC, String, RELIABLE)
    writer = node(pair.writers, "/robot/talker").advertise(TOPIC, String, RELIABLE)
    pair.wait_for_peers()

    for letter in "abcd":
        writer.publish(String(data=letter * 20_000))

    assert eventually(lambda: reader.subscription.dropped == 2)
    assert [word.data[0] for word in reader.pending()] == ["c", "d"]


def test_subscriber_gets_identity_of_message(pair: Pair) -> None:
    writer = node(pair.writers, "writer")
    reader = Reader(node(pair.readers, "reader"), TOPIC, String, RELIABLE)
    publisher = writer.advertise(TOPIC, String, RELIABLE)
    pair.wait_for_peers()
    assert reader.subscription.taken is None
    sent = [publisher.publish(String(data=word)) for word in ("one", "two")]
    reader.next_of(2)
    assert sent == [1, 2]
    assert reader.subscription.taken == (publisher.gid, 2)
    publisher.close()
    assert publisher.publish(String(data="late")) == 0
