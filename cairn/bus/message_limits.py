"""Limits on the length of messages: at each input, and at the transport of every process.

An input rejects a message longer than its `max_bytes` before it is copied or decoded, and reports
it. Zenoh discards messages of more than `TRANSPORT_FACTOR` times that when they arrive (its
`low_pass_filter`), and of more than `max_message_size` while they arrive: these are not reported,
because no component sees them.
"""

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from cairn.schemas.message import Field, fields_of

MAX_MESSAGE_SIZE = 32 << 20
"""Longest message [bytes] that a process accepts by default: a color image of 3840 x 2160 pixels.

Zenoh assembles up to 16 messages of one link at the same time: one of each priority, reliable or
best effort.
"""

LONGEST_MAX_BYTES = 1 << 30
"""Highest limit that can be set [bytes]."""

TRANSPORT_FACTOR = 4
"""Messages up to so many times the limit of an input reach it, so that it can report them."""

FIXED_BYTES = 4 << 10
"""Default limit [bytes] of a message of fixed length, but for its frames: twists, odometry."""

TEXT_BYTES = 64 << 10
"""Default limit [bytes] of a message with texts."""

SEQUENCE_BYTES = 1 << 20
"""Default limit [bytes] of a message with sequences: scans, paths."""

PENDING_BYTES = 16 << 20
"""Pending messages of one input [bytes]; a single one may be longer."""

RING_BYTES = 128 << 20
"""Samples of one input that wait in Zenoh's ring [bytes], of which there are at least two."""

REQUEST_BYTES = 256 << 10
"""Longest control request [bytes]."""

REPLY_BYTES = 1 << 20
"""Longest reply to a control request [bytes]."""

_CONTROL_KEYS = "@cairn/**"
_HEADER_BYTES = 1024  # of a message on the wire: key, encoding, attachment
_MAX_NAMES = 16
_BYTES = frozenset({"int8", "uint8", "byte"})


class MessageLimits(BaseModel):
    """What the transport of every process of a run accepts.

    Attributes:
        max_message_size: longest message [bytes].
        topics: longest message [bytes] of a topic, by full name, where it is shorter.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    max_message_size: int = MAX_MESSAGE_SIZE
    topics: Mapping[str, int] = {}

    def of(self, topic: str) -> int:
        """Return the longest payload [bytes] that arrives on a topic (full name)."""
        longest = self.max_message_size - _HEADER_BYTES
        return min(longest, self.topics.get(topic, longest))

    def transport_settings(self) -> dict[str, Any]:
        """Return the Zenoh settings by which a session discards what is longer."""
        filters = [
            _filter("requests", ("query",), _CONTROL_KEYS, REQUEST_BYTES),
            _filter("replies", ("reply",), _CONTROL_KEYS, REPLY_BYTES),
            *(
                # Of any domain and type: the robot's name is that of this run.
                _filter(topic, ("put", "reply"), f"*{topic}/*/*", size + _HEADER_BYTES)
                for topic, size in sorted(self.topics.items())
            ),
        ]
        return {
            "transport/link/rx/max_message_size": self.max_message_size,
            "low_pass_filter": filters,
        }


DEFAULT_LIMITS = MessageLimits()
"""Those of a session that belongs to no deployment."""


def _filter(name: str, messages: tuple[str, ...], key: str, size: int) -> dict[str, Any]:
    return {
        "id": name,
        "flows": ["ingress"],
        "messages": list(messages),
        "key_exprs": [key],
        "size_limit": size,
    }


def is_bulk(message: type[Any]) -> bool:
    """Return whether messages of this class may be big: they hold an image, a map or so."""
    return any(
        field.packed
        or (field.count == 0 and field.element in _BYTES)
        or (isinstance(field.element, type) and is_bulk(field.element))
        for field in fields_of(message)
    )


def default_max_bytes(message: type[Any]) -> int:
    """Return the limit [bytes] of an input with messages of this class that declares none."""
    return max(_default(message), FIXED_BYTES)


def has_fixed_size(message: type[Any]) -> bool:
    """Return whether all messages of this class have the same length, but for their frames."""
    return default_max_bytes(message) == FIXED_BYTES


def _default(message: type[Any]) -> int:
    longest = 0
    for field in fields_of(message):
        if field.count == 0:
            longest = max(longest, MAX_MESSAGE_SIZE if field.element in _BYTES else SEQUENCE_BYTES)
        elif field.element == "string" and not field.name.endswith("frame_id"):
            longest = max(longest, TEXT_BYTES)
        if isinstance(field.element, type):
            longest = max(longest, _default(field.element))
    return longest


def length_of(message: Any) -> int:
    """Return the length of a message as CDR [bytes], but for padding, without encoding it."""
    return 4 + _length(message)


def _length(message: Any) -> int:
    fixed, variable = _layout(type(message))
    return fixed + sum(measure(getattr(message, name)) for name, measure in variable)


_Layout = tuple[int, tuple[tuple[str, Callable[[Any], int]], ...]]
_layouts: dict[type[Any], _Layout] = {}


def _layout(message: type[Any]) -> _Layout:
    """Return the length of a class's fixed fields, and functions that measure the others."""
    if message in _layouts:
        return _layouts[message]
    fixed = 0
    variable: list[tuple[str, Callable[[Any], int]]] = []
    for field in fields_of(message):
        if field.count == 0:
            fixed += 4  # its number of elements
            variable.append((field.name, _sequence_measure(field)))
        elif field.count and (isinstance(field.element, type) or field.element == "string"):
            variable.append((field.name, _sequence_measure(field)))
        elif isinstance(field.element, type):
            inner, more = _layout(field.element)
            fixed += 0 if more else inner
            if more:
                variable.append((field.name, _length))
        elif field.element == "string":
            fixed += 5  # its length, and a zero byte
            variable.append((field.name, _text_bytes))
        else:
            fixed += _item_bytes(field.element) * (field.count or 1)
    _layouts[message] = fixed, tuple(variable)
    return _layouts[message]


def _sequence_measure(field: Field) -> Callable[[Any], int]:
    if field.packed:
        return lambda packed: int(packed.array.nbytes)
    if isinstance(field.element, type):
        inner, more = _layout(field.element)
        return (
            (lambda items: sum(map(_length, items))) if more else lambda items: inner * len(items)
        )
    if field.element == "string":
        return lambda texts: sum(5 + _text_bytes(text) for text in texts)
    size = _item_bytes(field.element)
    return lambda array: size * len(array)


def _text_bytes(text: str) -> int:
    return len(text) if text.isascii() else len(text.encode())


def _item_bytes(element: str) -> int:
    return 1 if element in ("byte", "char") else np.dtype(element).itemsize


def ring_length(depth: int, max_bytes: int) -> int:
    """Return how many samples the ring of an input holds at most."""
    longest = min(TRANSPORT_FACTOR * max_bytes, MAX_MESSAGE_SIZE)
    return min(depth, max(2, RING_BYTES // longest))


class PublisherLog:
    """Reports what is wrong with messages or endpoints, rate-limited for each that causes it."""

    def __init__(self, report: Callable[[str], None]) -> None:
        """`report` receives the 1st, 2nd, 4th, 8th ... problem with each publisher."""
        self._report = report
        self._lock = threading.Lock()
        self._counts: dict[str, int] = {}

    def add(self, publisher: str, problem: Callable[[str], str]) -> None:
        """Count a problem with a publisher; `problem(publisher)` returns its description."""
        with self._lock:
            if publisher not in self._counts and len(self._counts) >= _MAX_NAMES:
                publisher = "further publishers"  # a peer can take any number of names
            count = self._counts[publisher] = self._counts.get(publisher, 0) + 1
        if count == 1:
            self._report(problem(publisher))
        elif count & (count - 1) == 0:
            suppressed = count // 2 - 1
            self._report(
                f"{problem(publisher)} ({count} from there so far, suppressed {suppressed})"
            )


def too_long(topic: str, publisher: str, size: int, limit: int) -> str:
    """Return the error message about a message that an input has rejected by its length."""
    return (
        f"rejected a message of {size:,} bytes on {topic} from {publisher}: this input accepts at "
        f"most {limit:,} bytes; correct the publisher, or raise `max_bytes` of the input"
    )
