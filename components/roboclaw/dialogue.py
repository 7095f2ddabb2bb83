"""Questions and orders to a RoboClaw over a line, repeated when they are not understood."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from cairn.components.roboclaw import commands, status
from cairn.components.roboclaw.commands import Order, Question
from cairn.components.roboclaw.packets import (
    ACKNOWLEDGED,
    PACKET_TIMEOUT_S,
    SUM_SIZE,
    order_packet,
    question_packet,
    reply_data,
)
from cairn.driver.errors import DeviceError
from cairn.driver.link import Link

_BITS_PER_BYTE = 10  # start, eight of data, stop
_LATE = 128  # bytes of earlier replies that may come before the one that is waited for


@dataclass
class DialogueCounts:
    """How often something was sent, and how often sent once more."""

    packets: int = 0
    retries: int = 0
    silent: int = 0
    """Of the retries: because no reply, or not all of it, came in time."""
    garbled: int = 0
    """Of the retries: because what came was not the reply, or its sum was wrong."""


class Dialogue:
    """Talks with one RoboClaw on a line, one packet at a time.

    All packets that it sends may be sent twice without harm: they set or read, and count nothing.
    """

    def __init__(
        self,
        link: Link,
        address: int,
        baud: int,
        counts: DialogueCounts,
        *,
        reply_limit_s: float = 0.06,
        tries: int = 4,
    ) -> None:
        """`reply_limit_s`: how long a reply may take, beyond its bytes at `baud` [bit/s]."""
        self._link = link
        self._address = address
        self._byte_s = _BITS_PER_BYTE / baud
        self._counts = counts
        self._limit_s = reply_limit_s
        self._tries = tries
        self._shorter: set[int] = set()  # commands whose replies are known to be short

    def order(self, order: Order) -> None:
        """Send an order, and have it acknowledged; raises `DeviceError`."""
        packet = order_packet(self._address, order.command, order.data)
        self._converse(order.command, packet, len(ACKNOWLEDGED), _acknowledgment)

    def ask(self, question: Question) -> tuple[int, ...]:
        """The numbers that answer a question; raises `DeviceError`."""
        return question.decode(self._ask(question.command, question.size, self._data(question)))

    def ask_either(self, longer: Question, shorter: Question) -> tuple[int, ...]:
        """The numbers that answer a question whose reply has grown with the firmware.

        Which one it is, is found out by asking, and remembered.
        """
        if longer.command in self._shorter:
            return self.ask(shorter)
        whole, short = self._data(longer), self._data(shorter)
        data = self._ask(longer.command, longer.size, whole, in_the_end=short)
        if len(data) == longer.size:
            return longer.decode(data)
        self._shorter.add(longer.command)
        return shorter.decode(data)

    def version(self) -> str:
        """The product's name and the version of its firmware."""

        def whole(reply: bytes) -> bytes | None:
            end = reply.find(commands.VERSION_END)
            if end < 0:
                return None
            size = end + len(commands.VERSION_END) + SUM_SIZE
            return reply_data(self._address, commands.READ_VERSION, reply[:size])

        data = self._ask(commands.READ_VERSION, commands.LONGEST_VERSION, whole)
        return data.rstrip(commands.VERSION_END).decode("ascii", "replace")

    def status(self) -> status.Status:
        """What the RoboClaw says of itself."""
        (bits,) = self.ask_either(commands.STATUS, commands.OLD_STATUS)
        old = commands.READ_STATUS in self._shorter
        return status.decode_old(bits) if old else status.decode(bits)

    def _data(self, question: Question) -> Callable[[bytes], bytes | None]:
        size = question.size + SUM_SIZE

        def whole(reply: bytes) -> bytes | None:
            # What was asked before may be answered late, in front of it.
            return reply_data(self._address, question.command, reply[-size:])

        return whole

    def _ask(
        self,
        command: int,
        size: int,
        whole: Callable[[bytes], bytes | None],
        in_the_end: Callable[[bytes], bytes | None] | None = None,
    ) -> bytes:
        packet = question_packet(self._address, command)
        return self._converse(command, packet, size + SUM_SIZE, whole, in_the_end)

    def _converse(
        self,
        command: int,
        packet: bytes,
        size: int,
        whole: Callable[[bytes], bytes | None],
        in_the_end: Callable[[bytes], bytes | None] | None = None,
    ) -> bytes:
        """Send a packet until its reply comes: `size` bytes at most, of which `whole` makes data.

        `in_the_end` is asked of what has come when no more comes.
        """
        self._counts.packets += 1
        reply = b""
        until = time.monotonic() + self._tries * (self._limit_s + 4.0 * PACKET_TIMEOUT_S)
        for attempt in range(self._tries):
            if attempt and time.monotonic() > until + self._tries * size * self._byte_s:
                break  # this process was held up: what it was to say then may be wrong now
            if attempt:
                self._counts.retries += 1
                # What it has of a packet it forgets in this time; what it still sends comes.
                self._link.read(2.0 * PACKET_TIMEOUT_S)
            self._link.discard()
            self._link.write(packet)
            reply, data = self._reply(size, whole)
            if data is None and in_the_end is not None:
                data = in_the_end(reply)
            if data is not None:
                return data
            if len(reply) < size:
                self._counts.silent += 1
            else:
                self._counts.garbled += 1
        raise DeviceError(
            f"{self._link.name}: the RoboClaw at address 0x{self._address:02x} "
            + (
                f"answers command {command} with what is no reply ({reply[:16].hex(' ')})"
                if reply
                else f"does not answer command {command}"
            )
            + "; see that it is in packet serial mode, and that address and baud are right"
        )

    def _reply(
        self, size: int, whole: Callable[[bytes], bytes | None]
    ) -> tuple[bytes, bytes | None]:
        reply = b""
        until = time.monotonic() + self._limit_s + size * self._byte_s
        while len(reply) < size + _LATE:
            came = self._link.read(max(0.0, until - time.monotonic()))
            if not came:
                break
            reply += came
            data = whole(reply)
            if data is not None:
                return reply, data
        return reply, None


def _acknowledgment(reply: bytes) -> bytes | None:
    return reply if reply == ACKNOWLEDGED else None
