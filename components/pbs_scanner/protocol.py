"""The protocol of the PBS-03JN, without a line: frames, payloads, and the client's requests.

Frames are payloads with a check sum, as printable characters between two marks; damaged frames are
detected and dropped here. The client obtains a link code, requests the link with it, renews that,
and requests distances again and again.

No document of Hokuyo's is public; this is what the two public drivers for it agree on (Player's
`pbs_driver`, Aalborg 2006; Synapticon's, 2013).
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray

RAYS = 121
BAUD = 57600
"""Speed of its line [bit/s]: seven data bits, no parity."""

LINK_S = 3.0
"""How long the sensor holds the link after a request [s]."""

LINK_CODE = b"\xa0\x69"
LINK = b"\xa0\x5a"
DISTANCES = b"\xa2\x69"

FRAME_BEGIN, FRAME_END = b"\x02", b"\x03"

_LONGEST_FRAME = 1024  # characters; anything longer is noise
_ZERO = 0x20
_POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, lowest bit first
_CODE_LENGTH = 8
_REPLY_TIMEOUT_S = 0.3  # a reply with distances takes 0.05 s on the line
_RENEW_S = 2.0  # of the three seconds for which the link holds
_LINK_TRIES = 4  # for a link, before the link code is requested again
_DISTANCE_TRIES = 3  # for distances, before the link is requested again
_SILENT_REQUESTS = 8  # requests of any kind in a row without a reply: no sensor is there

_Request = Literal["code", "link", "distances"]


class FrameError(ValueError):
    """An impossible frame: damaged on the line."""


class PbsClient:
    """Decides what to send when, and takes the replies. Times are of one clock [s].

    It makes one request at a time, and accepts any reply.
    """

    def __init__(self, period_s: float) -> None:
        """`period_s`: time between two requests of distances [s]."""
        self.linked = False
        self.refusals = 0
        """How often the sensor has refused the link since it granted it last."""
        self.missed = 0
        """Requests without a reply so far."""
        self.requested_at = -math.inf
        """When distances were requested last [s]."""
        self._period_s = period_s
        self._code: bytes | None = None
        self._pending: _Request | None = None
        self._pending_since = -math.inf
        self._linked_at = -math.inf
        self._failed: dict[_Request, int] = {"code": 0, "link": 0, "distances": 0}
        self._unanswered = 0

    @property
    def silent(self) -> bool:
        """Whether so many requests had no reply that no sensor can be there."""
        return self._unanswered >= _SILENT_REQUESTS

    def due(self) -> float:
        """Return when `step` has something to do next [s]."""
        if self._pending is not None:
            return self._pending_since + _REPLY_TIMEOUT_S
        if self._code is None or not self.linked:
            return -math.inf
        return min(self._linked_at + _RENEW_S, self.requested_at + self._period_s)

    def step(self, now: float) -> bytes | None:
        """Return the frame to send now, if any."""
        if now < self.due():
            return None
        if self._pending is not None:
            self._time_out(self._pending)
        if self._code is None:
            return self._request("code", LINK_CODE, now)
        if not self.linked or now >= self._linked_at + _RENEW_S:
            return self._request("link", link_request(self._code), now)
        self.requested_at = now
        return self._request("distances", DISTANCES, now)

    def receive(self, payload: bytes, now: float) -> NDArray[np.int32] | None:
        """Take a reply, also an unexpected one; return its distances [mm], if it has any.

        Now and then distances are received instead of the link's confirmation: they are valid.
        """
        code, linked = parse_link_code(payload), parse_link(payload)
        distances = parse_distances(payload)
        if code is not None:
            self._code = code
            self._note_reply("code")
        elif linked is not None:
            self.linked, self._linked_at = linked, now
            if linked:
                self._note_reply("link")
                self.refusals = 0
            else:
                self._code = None  # it may have another one by now
                self.refusals += 1
                self._pending, self._pending_since = "link", now  # requested again a little later
        elif distances is not None:
            self._note_reply("distances")
        return distances

    def unlink(self) -> bytes | None:
        """Return the frame that ends the link, if there is one."""
        if self._code is None or not self.linked:
            return None
        self.linked = False
        return encode_frame(link_request(self._code, on=False))

    def _request(self, request: _Request, payload: bytes, now: float) -> bytes:
        self._pending, self._pending_since = request, now
        return encode_frame(payload)

    def _note_reply(self, request: _Request) -> None:
        self._unanswered = self._failed[request] = 0
        if self._pending == request:
            self._pending = None

    def _time_out(self, request: _Request) -> None:
        self._pending = None
        self.missed += 1
        self._unanswered += 1
        self._failed[request] += 1
        if request == "link" and self._failed["link"] >= _LINK_TRIES:
            self._code, self.linked, self._failed["link"] = None, False, 0
        elif request == "distances" and self._failed["distances"] >= _DISTANCE_TRIES:
            self.linked, self._failed["distances"] = False, 0


class FrameSplitter:
    """Splits received bytes into payloads. After noise it recovers at the next frame."""

    def __init__(self) -> None:
        self._rest = b""
        self.damaged = 0
        """How many frames were damaged so far."""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the payloads of the frames that these bytes complete."""
        *parts, self._rest = (self._rest + data).split(FRAME_END)
        if len(self._rest) > _LONGEST_FRAME:
            self._rest = b""
        payloads = []
        for part in parts:
            before, mark, frame = part.rpartition(FRAME_BEGIN)
            try:
                payloads.append(decode_frame(frame if mark else before))
            except FrameError:
                self.damaged += 1
        return payloads


def encode_frame(payload: bytes) -> bytes:
    """Return a payload as a frame for the line; its check sum follows it, lowest byte first."""
    return FRAME_BEGIN + _characters(payload + crc16(payload).to_bytes(2, "little")) + FRAME_END


def decode_frame(frame: bytes) -> bytes:
    """Return the payload of a frame without its marks; raises `FrameError` if it is damaged."""
    data = _bytes(frame)
    payload, received = data[:-2], int.from_bytes(data[-2:], "little")
    if not payload or crc16(payload) != received:
        raise FrameError(f"the check sum of a frame of {len(frame)} characters is wrong")
    return payload


def crc16(data: bytes) -> int:
    """Return the CRC-16/KERMIT; that of `123456789` is 0x2189."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (_POLYNOMIAL if crc & 1 else 0)
    return crc


def link_request(code: bytes, *, on: bool = True) -> bytes:
    """Return the payload that requests the link, or its end, by the check sum of the link code."""
    return LINK + bytes([on]) + crc16(code).to_bytes(2, "little")


def parse_link_code(payload: bytes) -> bytes | None:
    """Return the link code, None if the payload has none."""
    is_code = payload[:2] == LINK_CODE and len(payload) == 2 + _CODE_LENGTH
    return payload[2:] if is_code else None


def parse_link(payload: bytes) -> bool | None:
    """Return whether the link holds, None if the payload does not say."""
    return payload[2] == 1 if payload[:2] == LINK and len(payload) == 3 else None


def parse_distances(payload: bytes) -> NDArray[np.int32] | None:
    """Return the distances [mm] of all rays, from right to left; None if there are none."""
    if payload[:2] != DISTANCES or len(payload) != 2 + 2 * RAYS:
        return None
    return np.frombuffer(payload, "<u2", offset=2).astype(np.int32)


def _characters(data: bytes) -> bytes:
    """Encode six bits per character, the highest first; the last one is filled with zeros."""
    count = -(-len(data) * 8 // 6)
    bits = int.from_bytes(data, "big") << (count * 6 - len(data) * 8)
    return bytes(_ZERO + (bits >> 6 * place) % 64 for place in reversed(range(count)))


def _bytes(characters: bytes) -> bytes:
    bits = 0
    for character in characters:
        if not _ZERO <= character < _ZERO + 64:
            raise FrameError(f"a frame holds the byte {character}")
        bits = bits << 6 | character - _ZERO
    count = len(characters) * 6 // 8
    return (bits >> (len(characters) * 6 - count * 8)).to_bytes(count, "big")
