"""Frames of the PBS-03JN: payloads with a checksum, as printable characters between two marks.

No document of Hokuyo's is public; this is what the two public drivers for it agree on (Player's
`pbs_driver`, Aalborg 2006; Synapticon's, 2013).
"""

from __future__ import annotations

BEGIN, END = b"\x02", b"\x03"

_LONGEST = 1024  # characters; what is longer is noise
_ZERO = 0x20
_POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, lowest bit first


class FrameError(ValueError):
    """A frame that cannot be: damaged on its way."""


def crc16(data: bytes) -> int:
    """CRC-16/KERMIT, of which `123456789` has 0x2189."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (_POLYNOMIAL if crc & 1 else 0)
    return crc


def framed(payload: bytes) -> bytes:
    """A payload as it goes onto the line: its checksum behind it, lowest byte first."""
    return BEGIN + _characters(payload + crc16(payload).to_bytes(2, "little")) + END


def payload_of(frame: bytes) -> bytes:
    """The payload of what stood between two marks; raises `FrameError` if it was damaged."""
    data = _bytes(frame)
    payload, given = data[:-2], int.from_bytes(data[-2:], "little")
    if not payload or crc16(payload) != given:
        raise FrameError(f"the checksum of a frame of {len(frame)} characters is wrong")
    return payload


class FrameSplitter:
    """Collects bytes, gives payloads. After noise it is in step again with the next frame."""

    def __init__(self) -> None:
        self._held = b""
        self.damaged = 0
        """How many frames were damaged so far."""

    def feed(self, data: bytes) -> list[bytes]:
        """The payloads of the frames that these bytes complete."""
        *parts, self._held = (self._held + data).split(END)
        if len(self._held) > _LONGEST:
            self._held = b""
        payloads = []
        for part in parts:
            before, mark, frame = part.rpartition(BEGIN)
            try:
                payloads.append(payload_of(frame if mark else before))
            except FrameError:
                self.damaged += 1
        return payloads


def _characters(data: bytes) -> bytes:
    """Six bits to a character, the highest first; the last ones are filled up with zeros."""
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
