"""The tap over Zenoh: what it delivers of components, and of programs that follow no rules."""

import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest
import zenoh

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.qos import LATCHED, RELIABLE
from cairn.bus.session import open_client, open_router
from cairn.bus.type_hash import type_hash
from cairn.bus.zenoh_bus import ZenohBus
from cairn.recording.tap import PublisherInfo, Sample, ZenohTap
from cairn.schemas.std_msgs import String
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes

KEY = keys.message_key(0, "/robot/text", String)


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[ZenohBus]:
    bus = ZenohBus(open_router(tmp_path / "private" / "bus.sock"))
    yield bus
    bus.close()


@pytest.fixture
def client(bus: ZenohBus, tmp_path: Path) -> Iterator[zenoh.Session]:
    session = open_client([f"unixsock-stream/{tmp_path}/private/bus.sock"])
    yield session
    session.close()


def await_that(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def await_subscriber(session: zenoh.Session, key: str) -> None:
    """Wait until a session knows of a subscriber: Zenoh drops what is put before."""
    publisher = session.declare_publisher(key)
    await_that(lambda: cast("Any", publisher.matching_status).matching)
    publisher.undeclare()


@pytest.mark.parametrize("is_client", [True, False])
def test_tap_delivers_latched_messages_of_before_and_all_later_ones_once(
    bus: ZenohBus, client: zenoh.Session, is_client: bool
) -> None:
    node = bus.node("/robot/node", print)
    early = node.advertise("/robot/early", String, LATCHED.with_depth(2))
    for text in ("1", "2", "3"):
        early.publish(String(data=text))
    got: list[Sample] = []

    tap = ZenohTap(client, 0, got.append, is_client=is_client)
    await_that(lambda: len(got) == 2)
    for text in ("4", "5"):
        early.publish(String(data=text))
    late_node = bus.node("/robot/late_node", print)
    late = late_node.advertise("/robot/late", String, LATCHED)
    late.publish(String(data="late"))
    await_that(lambda: len(got) == 5)
    late_gid = next(one.gid for one in got if one.topic == "/robot/late")
    early_gid = next(one.gid for one in got if one.topic == "/robot/early")
    await_that(lambda: tap.publisher(late_gid) is not None)
    assert tap.is_present(late_gid)
    late_node.close()
    await_that(lambda: not tap.is_present(late_gid))
    assert tap.is_present(early_gid)
    tap.close()

    codec = Codec()
    by_topic = {
        topic: sorted(  # kept and new ones come on two threads
            (one.sequence, codec.decode(String, one.payload).data)
            for one in got
            if one.topic == topic
        )
        for topic in ("/robot/early", "/robot/late")
    }
    assert by_topic == {
        "/robot/early": [(2, "2"), (3, "3"), (4, "4"), (5, "5")],
        "/robot/late": [(1, "late")],
    }
    assert tap.publisher(early_gid) == PublisherInfo("/robot/node", LATCHED.with_depth(2))
    assert got[0].type_hash == type_hash(String)
    assert not tap.lost
    assert tap.refused == 0


def test_samples_of_foreign_programs_are_delivered_or_refused(
    bus: ZenohBus, client: zenoh.Session
) -> None:
    got: list[Sample] = []
    tap = ZenohTap(client, 0, got.append, ["/robot/**"])
    await_subscriber(bus.session, KEY)
    put = bus.session.put

    put(KEY, b"without attachment")
    put(KEY, b"again")
    put(KEY, b"not an attachment", attachment=b"\xff" * 100)
    extreme = struct.pack("<qqB16s", -(2**63), -(2**63), 16, b"g" * 16)
    put(KEY, b"impossible numbers", attachment=extreme)
    put("0/robot/text/not a type/hash", b"")
    put("0/robot/text", b"")
    put("0/other/text/std_msgs::msg::dds_::String_/hash", b"of another robot")
    bus.session.delete(KEY)
    put(KEY, b"", attachment=keys.Attachment(1, 5, b"h" * 16).encode())
    put(KEY, b"the end", attachment=keys.Attachment(4, 5, b"h" * 16).encode())
    await_that(lambda: bool(got) and got[-1].payload == b"the end")
    tap.close()

    texts = [(one.payload, one.sequence) for one in got]
    assert texts == [
        (b"without attachment", 1), (b"again", 2), (b"not an attachment", 3),
        (b"impossible numbers", -(2**63)), (b"", 1), (b"the end", 4),
    ]  # fmt: skip
    assert got[0].gid == got[2].gid == keys.gid(KEY)
    assert tap.refused == 2  # the invalid type, and the deletion
    assert tap.lost == {"/robot/text": 2}
    assert tap.publisher(got[0].gid) is None


def test_overlapping_patterns_deliver_a_message_once(bus: ZenohBus, client: zenoh.Session) -> None:
    got: list[Sample] = []
    tap = ZenohTap(client, 0, got.append, ["/robot/a*", "/robot/*b", "/robot/a*"])
    node = bus.node("/robot/node", print)
    for name in ("ab", "end_b"):
        node.advertise(f"/robot/{name}", String, RELIABLE)
    await_subscriber(bus.session, KEY)
    for name in ("ab", "c", "end_b"):
        bus.session.put(keys.message_key(0, f"/robot/{name}", String), name.encode())
    await_that(lambda: bool(got) and got[-1].topic == "/robot/end_b")
    tap.close()
    assert [one.topic for one in got if one.topic != "/robot/c"] == ["/robot/ab", "/robot/end_b"]


@pytest.mark.parametrize("is_client", [True, False])
def test_publisher_with_a_qos_that_cairn_does_not_have_is_known(
    bus: ZenohBus, client: zenoh.Session, is_client: bool
) -> None:
    token = (
        "@ros2_lv/0/abc/0/7/MP/%/%robot/foreign/%robot%text/std_msgs::msg::dds_::String_/"
        f"{type_hash(String)}/::2,:,7:1,:,,"  # keep all, with a deadline for each message
    )
    declared = bus.session.liveliness().declare_token(token)
    tap = ZenohTap(client, 0, print, is_client=is_client)

    await_that(lambda: tap.publisher(keys.gid(token)) is not None)

    tap.close()
    declared.undeclare()
