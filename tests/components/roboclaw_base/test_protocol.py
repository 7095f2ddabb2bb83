"""Packets byte by byte, compared with independent sources."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.roboclaw_base import protocol
from cairn.components.roboclaw_base.protocol import (
    crc16,
    read_packet,
    reply_data,
    reply_packet,
    write_packet,
)


def manuals_crc(data: bytes) -> int:
    """Translate the manual's C code (section "CRC16 Checksum Calculation") word for word."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021) & 0xFFFF if crc & 0x8000 else (crc << 1) & 0xFFFF
    return crc


def test_crc_has_the_catalog_check_value() -> None:
    assert crc16(b"123456789") == 0x31C3  # CRC-16/XMODEM


@given(st.binary(max_size=64))
def test_crc_agrees_with_the_manual(data: bytes) -> None:
    assert crc16(data) == manuals_crc(data)


@pytest.mark.parametrize(
    ("command", "packet"),
    [
        (protocol.set_timeout(0.5), "80 0e 05"),
        (protocol.drive_speed(8000, 4000, -4000), "80 28 00001f40 00000fa0 fffff060"),
        (protocol.switch_off(), "80 22 0000 0000"),
        (protocol.set_main_voltages(10.5, 16.8), "80 39 0069 00a8"),
        (protocol.set_main_voltages(10.5, 16.8, 1), "80 39 0069 00a8 01"),
    ],
)
def test_write_packets_have_the_layout_of_the_manual(
    command: protocol.WriteCommand, packet: str
) -> None:
    covered = bytes.fromhex(packet)

    assert write_packet(0x80, command.command, command.data) == covered + manuals_crc(
        covered
    ).to_bytes(2, "big")


def test_read_packet_has_no_crc() -> None:
    assert read_packet(0x80, protocol.ENCODERS.command) == b"\x80\x4e"


def test_replies_are_decoded_as_in_the_manual() -> None:
    assert protocol.ENCODERS.decode(bytes.fromhex("fffffffe 00000010")) == (4294967294, 16)
    assert protocol.CURRENTS.decode(bytes.fromhex("0078 ff88")) == (120, -120)
    assert protocol.SPEED_LOOPS[0].decode(bytes.fromhex("00010000 00008000 00004000 0000abe0")) == (
        0x10000,
        0x8000,
        0x4000,
        44000,
    )


@given(st.binary(max_size=20), st.integers(0x80, 0x87), st.integers(0, 255))
def test_reply_is_accepted_for_its_own_command_only(
    data: bytes, address: int, command: int
) -> None:
    reply = reply_packet(address, command, data)

    assert reply_data(address, command, reply) == data
    assert reply_data(address, command ^ 1, reply) is None


@given(st.binary(min_size=1, max_size=20), st.data())
def test_reply_with_a_flipped_bit_is_rejected(data: bytes, draw: st.DataObject) -> None:
    reply = bytearray(reply_packet(0x80, 78, data))
    bit = draw.draw(st.integers(0, 8 * len(reply) - 1))
    reply[bit // 8] ^= 1 << bit % 8

    assert reply_data(0x80, 78, bytes(reply)) is None


@pytest.mark.parametrize(("seconds", "steps"), [(0.02, 1), (0.1, 1), (0.5, 5), (99.0, 255)])
def test_serial_timeout_is_never_disabled(seconds: float, steps: int) -> None:
    assert protocol.timeout_steps(seconds) == steps
