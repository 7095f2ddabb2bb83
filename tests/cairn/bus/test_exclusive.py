"""Exclusive topics: no message passes that the entitled writer did not sign in this run."""

import time
from dataclasses import dataclass

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from cairn import LATCHED, RELIABLE
from cairn.bus.codec import Codec
from cairn.bus.exclusive import Exclusive, RefusalLog, Refused, Signer, Verifier
from cairn.bus.keys import Attachment, message_key
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.std_msgs import String
from tests.cairn.bus.network import Network, Reader, eventually
from tests.patience import LIMIT_S

TOPIC, KEY = "/robot/word", message_key(0, "/robot/word", String)
GATE = Exclusive("/robot/gate", bytes(range(32)))
CODEC = Codec()


@dataclass
class Signed:
    """A message as it is on the wire."""

    head: bytes
    proof: bytes
    payload: bytes


def signed(signer: Signer, payload: bytes = b"ahead") -> Signed:
    head = Attachment(1, 2, bytes(16)).head()
    return Signed(head, signer.proof(head, payload), payload)


def verifier(key: str = KEY, entitled: Exclusive = GATE, since_ns: int = 0) -> Verifier:
    return Verifier(entitled, key, since_ns)


def test_messages_of_the_writer_pass_in_order() -> None:
    signer, reader = Signer(GATE, KEY), verifier()

    for payload in (b"", b"ahead", bytes(100_000)):
        one = signed(signer, payload)
        reader.verify(one.head, one.proof, one.payload)


@given(st.data())
def test_any_change_of_a_signed_message_is_refused(data: st.DataObject) -> None:
    one = signed(Signer(GATE, KEY), data.draw(st.binary(min_size=1, max_size=300)))
    parts = [one.head, one.proof, one.payload]
    which = data.draw(st.integers(0, 2))
    bit = data.draw(st.integers(0, 8 * len(parts[which]) - 1))
    changed = bytearray(parts[which])
    changed[bit // 8] ^= 1 << bit % 8
    parts[which] = bytes(changed)

    with pytest.raises(Refused):
        verifier().verify(*parts)


@pytest.mark.parametrize(
    "reader",
    [
        verifier(entitled=Exclusive(GATE.writer, bytes(32))),
        verifier(entitled=Exclusive(GATE.writer)),
        verifier(key=message_key(0, "/robot/other", String)),
    ],
    ids=["another key", "no key", "another topic"],
)
def test_message_is_refused_without_its_key_and_topic(reader: Verifier) -> None:
    one = signed(Signer(GATE, KEY))

    with pytest.raises(Refused):
        reader.verify(one.head, one.proof, one.payload)


def test_repeated_and_earlier_messages_are_refused() -> None:
    signer, reader = Signer(GATE, KEY), verifier()
    first, second = signed(signer, b"1"), signed(signer, b"2")
    reader.verify(second.head, second.proof, second.payload)

    for replayed in (first, second):
        with pytest.raises(Refused, match="repeats or precedes"):
            reader.verify(replayed.head, replayed.proof, replayed.payload)


def test_messages_from_before_the_subscription_are_refused() -> None:
    recorded = signed(Signer(GATE, KEY))
    reader = verifier(since_ns=time.monotonic_ns())

    with pytest.raises(Refused, match="repeats or precedes"):
        reader.verify(recorded.head, recorded.proof, recorded.payload)


def test_restarted_writer_continues_after_the_system_time_was_set_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reader = verifier()
    before = signed(Signer(GATE, KEY))
    reader.verify(before.head, before.proof, before.payload)
    monkeypatch.setattr(time, "time_ns", lambda: 0)

    after = signed(Signer(GATE, KEY))

    reader.verify(after.head, after.proof, after.payload)


def test_writer_signs_in_order_within_one_tick_of_the_clock(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(time, "monotonic_ns", lambda: 5)
    signer, reader = Signer(GATE, KEY), verifier()

    for _ in range(3):
        one = signed(signer)
        reader.verify(one.head, one.proof, one.payload)


def test_publishers_without_end_do_not_fill_log_and_memory() -> None:
    reports: list[str] = []
    log = RefusalLog(TOPIC, GATE, reports.append)

    for number in range(10_000):
        log.refuse(f"/robot/ghost_{number}", "it is not signed")

    assert log.refused == 10_000
    assert len(reports) < 100


class Attack:
    """A peer that has recorded the gate's messages, and knows everything but the key."""

    def __init__(self, bus: ZenohBus) -> None:
        self.bus = bus
        self.recorded: list[zenoh.Sample] = []
        self._subscriber = bus.session.declare_subscriber(
            KEY, zenoh.handlers.Callback(self.recorded.append, indirect=False)
        )

    def put(self, payload: bytes, attachment: bytes | None) -> None:
        block = zenoh.CongestionControl.BLOCK
        self.bus.session.put(KEY, payload, attachment=attachment, congestion_control=block)


@pytest.mark.processes
def test_replayed_and_forged_messages_are_refused_and_displace_nothing() -> None:
    network = Network()
    try:
        reports: list[str] = []
        base, gate, attack = network.bus(), network.bus(), Attack(network.bus())
        reader = Reader(base.node("/robot/base", reports.append), TOPIC, String, RELIABLE, GATE)
        writer = gate.node("/robot/gate", reports.append).advertise(TOPIC, String, RELIABLE, GATE)
        assert attack.bus.wait_for_peers(LIMIT_S) == gate.wait_for_peers(LIMIT_S) == []
        writer.publish(String(data="first"))
        writer.publish(String(data="second"))
        assert eventually(lambda: len(attack.recorded) == 2)
        reader.await_first()

        recorded = attack.recorded[0].attachment
        assert recorded is not None
        genuine = Attachment.decode(recorded.to_bytes())
        newer = genuine._replace(sequence=9, proof=bytes([255] * 7 + [127] + [0] * 16))
        for sample in tuple(attack.recorded):
            assert sample.attachment is not None
            attack.put(sample.payload.to_bytes(), sample.attachment.to_bytes())
        for attachment in (None, b"", bytes(33), bytes(5_000_000), *2 * [newer.encode()]):
            attack.put(CODEC.encode(String(data="forged")), attachment)
        for number in range(200):
            forged = Attachment(number, 0, bytes(16)).encode()
            attack.put(CODEC.encode(String(data="forged")), forged)

        assert eventually(lambda: reader.subscription.refused == 208)
        assert [word.data for word in reader.pending()] == ["first", "second"]
        assert reader.subscription.dropped == 0
        assert any("claims to be /robot/gate: it repeats" in report for report in reports)
        assert any("claims to be /robot/gate: its signature" in report for report in reports)
        assert any("not in the graph: it is not signed" in report for report in reports)
        writer.publish(String(data="third"))
        assert eventually(lambda: [word.data for word in reader.pending()] == ["third"])
    finally:
        network.close()


@pytest.mark.processes
def test_late_reader_of_a_latched_exclusive_topic_receives_the_last_message() -> None:
    network = Network()
    try:
        gate, base, reports = network.bus(), network.bus(), list[str]()
        writer = gate.node("/robot/gate", reports.append).advertise(TOPIC, String, LATCHED, GATE)
        writer.publish(String(data="old"))
        writer.publish(String(data="last"))
        assert base.wait_for_peers(LIMIT_S) == []

        reader = Reader(base.node("/robot/base", reports.append), TOPIC, String, LATCHED, GATE)

        assert reader.next() == String(data="last")
        assert (reader.subscription.refused, reports) == (0, [])
    finally:
        network.close()
