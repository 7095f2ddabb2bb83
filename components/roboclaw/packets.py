"""Packets of the RoboClaw's packet serial mode: how bytes make a request and a reply.

Source: RoboClaw Series User Manual (Basicmicro), section "Packet Serial": "Address", "Packet
Timeout", "Packet Acknowledgement", "CRC16 Checksum Calculation".
"""

from __future__ import annotations

from binascii import crc_hqx

ADDRESSES = range(0x80, 0x88)
"""Addresses that a RoboClaw may have; over USB it answers to each of them."""

ACKNOWLEDGED = b"\xff"
"""The whole reply to a packet that sets or orders something. It bears no sum."""

SUM_SIZE = 2

PACKET_TIMEOUT_S = 0.010
"""A packet whose bytes come further apart than this [s] is thrown away by the RoboClaw."""


def crc16(data: bytes) -> int:
    """The CRC of bytes: polynomial 0x1021, begun at 0, not reflected (CRC-16/XMODEM)."""
    return crc_hqx(data, 0)


def order_packet(address: int, command: int, data: bytes = b"") -> bytes:
    """The packet that orders or sets something; `ACKNOWLEDGED` answers it."""
    packet = bytes((address, command)) + data
    return packet + crc16(packet).to_bytes(SUM_SIZE, "big")


def question_packet(address: int, command: int) -> bytes:
    """The packet that reads something. It bears no sum: the reply's covers it."""
    return bytes((address, command))


def reply_packet(address: int, command: int, data: bytes) -> bytes:
    """What a RoboClaw answers to a question: the data, and the sum of the question and these."""
    covered = question_packet(address, command) + data
    return data + crc16(covered).to_bytes(SUM_SIZE, "big")


def reply_data(address: int, command: int, reply: bytes) -> bytes | None:
    """The data of a reply; None if its sum is wrong, or it is the reply to something else."""
    data = reply[:-SUM_SIZE]
    return data if reply_packet(address, command, data) == reply else None
