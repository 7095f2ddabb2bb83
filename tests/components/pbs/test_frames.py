"""Frames of the PBS-03JN, on vectors on which two independent drivers agree."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.pbs import messages
from cairn.components.pbs.frames import FrameError, FrameSplitter, crc16, framed, payload_of

CODE = bytes.fromhex("1122334455667788")


def test_the_checksum_is_kermits() -> None:
    assert crc16(b"123456789") == 0x2189
    assert crc16(CODE) == 0x7439
    assert crc16(messages.LINK_CODE) == 0x5138
    assert crc16(messages.DISTANCES) == 0x6288


@pytest.mark.parametrize(
    ("payload", "wire"),
    [
        (messages.LINK_CODE, b"\x02H&DX40\x03"),
        (messages.DISTANCES, b"\x02HFF(8@\x03"),
        (messages.LINK_CODE + CODE, b"\x02H&D1(C-$569WB!=9\x03"),
        (messages.link_request(CODE), b"\x02H%H!.72Y[0\x03"),
        (messages.link_request(CODE, on=False), b"\x02H%H .71EMP\x03"),
        (messages.LINK + b"\x01", b"\x02H%H!V3 \x03"),
    ],
)
def test_frames_are_as_on_the_wire(payload: bytes, wire: bytes) -> None:
    assert framed(payload) == wire
    assert payload_of(wire[1:-1]) == payload


def test_distances_take_330_bytes() -> None:
    wire = framed(messages.DISTANCES + 121 * (1000).to_bytes(2, "little"))
    assert len(wire) == 330
    assert wire.startswith(b"\x02HFGH ^@#Z /")
    assert wire.endswith(b"Y-A\x03")
    found = messages.distances(payload_of(wire[1:-1]))
    assert found is not None
    assert found.tolist() == [1000] * 121


@settings(max_examples=50, deadline=None)
@given(st.binary(min_size=1, max_size=300))
def test_any_payload_comes_back(payload: bytes) -> None:
    wire = framed(payload)
    assert set(wire[1:-1]) <= set(range(0x20, 0x60))
    assert FrameSplitter().feed(wire) == [payload]


@settings(max_examples=50, deadline=None)
@given(
    payloads=st.lists(st.binary(min_size=1, max_size=40), max_size=6),
    pieces=st.lists(st.integers(1, 30), max_size=40),
    noise=st.binary(max_size=40),
)
def test_frames_are_found_behind_noise_and_in_pieces(
    payloads: list[bytes], pieces: list[int], noise: bytes
) -> None:
    splitter = FrameSplitter()
    data = noise + b"\x03" + b"".join(map(framed, payloads))
    found = []
    for size in [*pieces, len(data)]:
        found += splitter.feed(data[:size])
        data = data[size:]
    assert found == payloads


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_a_changed_bit_is_noticed(data: st.DataObject) -> None:
    wire = framed(messages.DISTANCES + data.draw(st.binary(min_size=242, max_size=242)))
    at = data.draw(st.integers(1, len(wire) - 2))
    changed = wire[at] ^ 1 << data.draw(st.integers(0, 7))
    with_fault = wire[:at] + bytes([changed]) + wire[at + 1 :]
    for payload in FrameSplitter().feed(with_fault):
        assert framed(payload) == wire  # filling, which means nothing, was hit


@pytest.mark.parametrize("frame", [b"", b"H", b"H&DX40x", b"H&DX50", b"H&DX4"])
def test_what_is_no_frame_is_refused(frame: bytes) -> None:
    with pytest.raises(FrameError):
        payload_of(frame)
