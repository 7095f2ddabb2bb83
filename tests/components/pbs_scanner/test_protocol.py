"""Frames of the PBS-03JN, on vectors of two independent drivers; its client, without a line."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.pbs_scanner import protocol
from cairn.components.pbs_scanner.emulator import EmulatedPbs, SentDistances
from cairn.components.pbs_scanner.messages import PbsMessages
from cairn.components.pbs_scanner.protocol import (
    FrameError,
    FrameSplitter,
    PbsClient,
    crc16,
    decode_frame,
    encode_frame,
)
from cairn.schemas.std_msgs import Header

CODE = bytes.fromhex("1122334455667788")


def test_check_sum_is_crc_16_kermit() -> None:
    assert crc16(b"123456789") == 0x2189
    assert crc16(CODE) == 0x7439
    assert crc16(protocol.LINK_CODE) == 0x5138
    assert crc16(protocol.DISTANCES) == 0x6288


@pytest.mark.parametrize(
    ("payload", "wire"),
    [
        (protocol.LINK_CODE, b"\x02H&DX40\x03"),
        (protocol.DISTANCES, b"\x02HFF(8@\x03"),
        (protocol.LINK_CODE + CODE, b"\x02H&D1(C-$569WB!=9\x03"),
        (protocol.link_request(CODE), b"\x02H%H!.72Y[0\x03"),
        (protocol.link_request(CODE, on=False), b"\x02H%H .71EMP\x03"),
        (protocol.LINK + b"\x01", b"\x02H%H!V3 \x03"),
    ],
)
def test_frames_equal_those_of_two_independent_drivers(payload: bytes, wire: bytes) -> None:
    assert encode_frame(payload) == wire
    assert decode_frame(wire[1:-1]) == payload


def test_distances_take_330_bytes() -> None:
    wire = encode_frame(protocol.DISTANCES + 121 * (1000).to_bytes(2, "little"))
    assert len(wire) == 330
    assert wire.startswith(b"\x02HFGH ^@#Z /")
    assert wire.endswith(b"Y-A\x03")
    found = protocol.parse_distances(decode_frame(wire[1:-1]))
    assert found is not None
    assert found.tolist() == [1000] * 121


@settings(max_examples=50, deadline=None)
@given(st.binary(min_size=1, max_size=300))
def test_payloads_are_decoded_as_encoded(payload: bytes) -> None:
    wire = encode_frame(payload)
    assert set(wire[1:-1]) <= set(range(0x20, 0x60))
    assert FrameSplitter().feed(wire) == [payload]


@settings(max_examples=50, deadline=None)
@given(
    payloads=st.lists(st.binary(min_size=1, max_size=40), max_size=6),
    pieces=st.lists(st.integers(1, 30), max_size=40),
    noise=st.binary(max_size=40),
)
def test_frames_are_found_after_noise_and_in_pieces(
    payloads: list[bytes], pieces: list[int], noise: bytes
) -> None:
    splitter = FrameSplitter()
    data = noise + b"\x03" + b"".join(map(encode_frame, payloads))
    found = []
    for size in [*pieces, len(data)]:
        found += splitter.feed(data[:size])
        data = data[size:]
    assert found == payloads


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_changed_bit_is_detected(data: st.DataObject) -> None:
    wire = encode_frame(protocol.DISTANCES + data.draw(st.binary(min_size=242, max_size=242)))
    at = data.draw(st.integers(1, len(wire) - 2))
    changed = wire[at] ^ 1 << data.draw(st.integers(0, 7))
    with_fault = wire[:at] + bytes([changed]) + wire[at + 1 :]
    for payload in FrameSplitter().feed(with_fault):
        assert encode_frame(payload) == wire  # the bit was padding


@pytest.mark.parametrize("frame", [b"", b"H", b"H&DX40x", b"H&DX50", b"H&DX4"])
def test_invalid_frames_are_rejected(frame: bytes) -> None:
    with pytest.raises(FrameError):
        decode_frame(frame)


class Exchange:
    """A client and a sensor, without a line between them."""

    def __init__(self, sensor: EmulatedPbs, client: PbsClient) -> None:
        self.sensor, self.client = sensor, client
        self.splitter = FrameSplitter()
        self.sent_frames: list[bytes] = []
        self.received: list[list[int]] = []
        self.deaf = False

    def run(self, begin: float, end: float) -> None:
        """Exchange frames, in steps of 10 ms."""
        for now in np.arange(begin, end, 0.01):
            frame = self.client.step(float(now))
            if frame is None:
                continue
            self.sent_frames.append(frame)
            answers = [] if self.deaf else self.sensor.receive(frame, float(now))
            for payload in self.splitter.feed(b"".join(answers)):
                distances = self.client.receive(payload, float(now))
                if distances is not None:
                    self.received.append(distances.tolist())


@pytest.fixture
def sent() -> list[SentDistances]:
    return []


@pytest.fixture
def exchange(sent: list[SentDistances]) -> Exchange:
    return Exchange(EmulatedPbs(on_scan=sent.append), PbsClient(0.1))


def test_client_links_and_receives_every_distance(
    exchange: Exchange, sent: list[SentDistances]
) -> None:
    exchange.run(0.0, 10.0)
    assert exchange.received == [one.distances.tolist() for one in sent]
    assert 95 <= len(sent) <= 100
    assert all(one.distances.size == 121 for one in sent)
    assert len({tuple(one) for one in exchange.received}) > 90
    # The link is renewed every two seconds, and holds for three.
    assert exchange.client.missed == 0
    assert sum(frame.startswith(b"\x02H%H") for frame in exchange.sent_frames) == 5


def test_sensor_sends_no_distances_without_a_link() -> None:
    sensor = EmulatedPbs(code=bytes(8))
    ask, link = encode_frame(protocol.DISTANCES), encode_frame(protocol.link_request(bytes(8)))
    assert sensor.receive(ask, 0.0) == []
    assert sensor.receive(encode_frame(protocol.link_request(b"another.")), 0.0) == [
        encode_frame(protocol.LINK + b"\x00")
    ]
    assert sensor.receive(ask, 0.0) == []
    assert sensor.receive(link, 1.0) == [encode_frame(protocol.LINK + b"\x01")]
    assert len(sensor.receive(ask, 3.9)) == 1
    assert sensor.receive(ask, 4.1) == []
    sensor.receive(link, 5.0)
    assert sensor.receive(encode_frame(protocol.link_request(bytes(8), on=False)), 5.1) == [
        encode_frame(protocol.LINK + b"\x00")
    ]
    assert sensor.receive(ask, 5.2) == []


def test_sensor_that_stays_silent_is_reported_as_silent(exchange: Exchange) -> None:
    exchange.run(0.0, 1.0)
    exchange.deaf = True
    exchange.run(1.0, 2.0)
    assert not exchange.client.silent
    exchange.deaf = False
    exchange.run(2.0, 4.0)
    assert not exchange.client.silent
    exchange.received.clear()
    exchange.run(4.0, 5.0)
    assert len(exchange.received) >= 9
    exchange.deaf = True
    exchange.run(5.0, 8.0)
    assert exchange.client.silent


def test_new_link_code_of_a_restarted_sensor_is_obtained(exchange: Exchange) -> None:
    exchange.run(0.0, 1.0)
    exchange.sensor.powered_on(1.0)
    exchange.run(1.0, 4.0)
    exchange.received.clear()
    exchange.run(4.0, 5.0)
    assert len(exchange.received) >= 9


def test_distances_instead_of_a_confirmation_are_accepted(exchange: Exchange) -> None:
    exchange.run(0.0, 1.0)
    found = exchange.client.receive(protocol.DISTANCES + bytes(242), 1.0)
    assert found is not None
    assert found.size == 121


def test_link_is_closed_only_once(exchange: Exchange) -> None:
    assert exchange.client.unlink() is None
    exchange.run(0.0, 1.0)
    last = exchange.client.unlink()
    assert last is not None
    assert exchange.sensor.receive(last, 1.0) == [encode_frame(protocol.LINK + b"\x00")]
    assert exchange.client.unlink() is None


def test_ranges_follow_rep_117() -> None:
    distances = np.full(121, 1500, np.int32)
    distances[:4] = 0, 150, 3001, 0xFFFF
    scan = PbsMessages(math.radians(1.8), 3.0).scan(distances, Header())
    assert math.isnan(scan.ranges[0])
    assert scan.ranges[1:5].tolist() == [-math.inf, math.inf, math.inf, 1.5]
    assert scan.angle_min == pytest.approx(-math.radians(108.0))
    assert scan.angle_max == pytest.approx(math.radians(108.0))
    assert (scan.range_min, scan.range_max) == pytest.approx((0.2, 3.0))
