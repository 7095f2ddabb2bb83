"""Exclusive topics: accept the messages of the one entitled writer, refuse and report all others.

Who is entitled follows from the deployment (`cairn.deployment.exclusive_topics`). Over Zenoh the
writer proves its identity in each message: a keyed hash of the message and of its time of sending.
Its readers have the same key. Times are those of the monotonic clock, which all processes of the
computer share and nothing sets back: a writer that was restarted continues, and a message that was
recorded earlier in the run is refused. A topic with writer and readers on several machines uses the
system time, as their monotonic clocks have nothing in common.
"""

import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import blake2b
from hmac import compare_digest

from pydantic import BaseModel, ConfigDict

from cairn.bus.message_limits import PublisherLog
from cairn.errors import CairnError

KEY_BYTES = 32
"""Length of the secret of a topic."""

PROOF_BYTES = 24
"""Length of the proof in an attachment: time of sending [ns] and tag."""

_CLOCK_TOLERANCE_NS = 1_000_000_000
"""The system times of two machines may differ by so much; a message recorded before the reader
started can be repeated to it for so long."""

_TAG_BYTES = 16
_PROOF = struct.Struct(f"<q{_TAG_BYTES}s")
_SENT = struct.Struct("<q")


@dataclass(frozen=True)
class Exclusive:
    """The entitlement to publish on one exclusive topic.

    `writer` is the full name of the entitled component, "" if there is none. `key` is the secret
    that the writer signs with and its readers verify with; the lockstep bus, on which a publisher's
    name cannot be forged, does not use it.
    """

    writer: str
    key: bytes = field(default=b"", repr=False)
    several_machines: bool = False
    """Whether the writer or a reader runs on another machine: times are those of the system."""

    def now_ns(self) -> int:
        """Return the time by which messages are signed [ns]."""
        return time.time_ns() if self.several_machines else time.monotonic_ns()

    @property
    def clock_tolerance_ns(self) -> int:
        """How much a message may seem to be older than its subscription [ns]."""
        return _CLOCK_TOLERANCE_NS if self.several_machines else 0


class ExclusiveTopic(BaseModel):
    """A topic that at least one input reads exclusively.

    `topic` is its full name. `writer` names the entitled component, "" if no component of the
    deployment publishes there. `external`: the topic has no writer in the deployment and is listed
    under `external_topics`, so messages of every publisher are accepted. `several_machines`: its
    writer and readers do not all run on one machine.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    topic: str
    writer: str
    readers: tuple[str, ...]
    external: bool = False
    several_machines: bool = False


class Refused(CairnError):
    """A message does not prove that the entitled writer sent it now."""


class Signer:
    """Proves the identity of an exclusive topic's writer; from one thread at a time."""

    def __init__(self, exclusive: Exclusive, key_expression: str) -> None:
        """Prepare for messages on a key expression."""
        self._tag = _Tag(exclusive, key_expression)
        self._now_ns = exclusive.now_ns
        self._last_ns = 0

    def proof(self, head: bytes, payload: bytes) -> bytes:
        """Return the proof for a message with this attachment (without proof) and payload."""
        self._last_ns = max(self._last_ns + 1, self._now_ns())
        return _PROOF.pack(self._last_ns, self._tag.of(self._last_ns, head, payload))


class Verifier:
    """Checks that messages come from an exclusive topic's writer; from one thread at a time."""

    def __init__(self, exclusive: Exclusive, key_expression: str, since_ns: int) -> None:
        """Prepare for messages on a key expression, sent after `since_ns` [ns]."""
        self._tag = _Tag(exclusive, key_expression) if exclusive.key else None
        self._last_ns = since_ns

    def check_order(self, proof: bytes) -> None:
        """Raise `Refused` if a proof is missing or not newer than the last verified message's.

        This needs no payload, so that most forged messages are refused at little cost.
        """
        if self._tag is None:
            raise Refused("this component has no key to verify it")
        if len(proof) != PROOF_BYTES:
            raise Refused("it is not signed")
        if _SENT.unpack_from(proof)[0] <= self._last_ns:
            raise Refused("it repeats or precedes a message received earlier")

    def verify(self, head: bytes, proof: bytes, payload: bytes) -> None:
        """Raise `Refused` unless the writer has signed this message and sent it after the last."""
        self.check_order(proof)
        sent_ns, tag = _PROOF.unpack(proof)
        assert self._tag is not None
        if not compare_digest(tag, self._tag.of(sent_ns, head, payload)):
            raise Refused("its signature is wrong")
        self._last_ns = sent_ns


class _Tag:
    """Computes the tag of messages on one key expression."""

    def __init__(self, exclusive: Exclusive, key_expression: str) -> None:
        topic = key_expression.encode()
        self._keyed = blake2b(key=exclusive.key, digest_size=_TAG_BYTES, person=b"cairn exclusive")
        self._keyed.update(_SENT.pack(len(topic)) + topic)

    def of(self, sent_ns: int, head: bytes, payload: bytes) -> bytes:
        digest = self._keyed.copy()
        digest.update(_SENT.pack(sent_ns) + head)
        digest.update(payload)
        return digest.digest()


class RefusalLog:
    """Counts the messages that an exclusive port refuses; reports them by publisher."""

    def __init__(self, topic: str, exclusive: Exclusive, report: Callable[[str], None]) -> None:
        self.writer = exclusive.writer
        """Full name of the entitled component, "" if there is none."""
        self.refused = 0
        """Number of refused messages."""
        self._topic = topic
        self._log = PublisherLog(report)

    def refuse(self, publisher: str, reason: str) -> None:
        """Count one message; `publisher` describes where it comes from."""
        self.refused += 1
        entitled = self.writer or "no component of this deployment"
        self._log.add(
            publisher,
            lambda named: (
                f"refused message on {self._topic} from {named}: {reason}; only {entitled} may "
                "publish on this exclusive topic"
            ),
        )
