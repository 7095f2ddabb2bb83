"""What happened during one recorded call, which its re-run is given and compared with."""

import json
from collections import defaultdict, deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from cairn.bus.bus import MessageId
from cairn.runtime.call_records import RecordKind


class CannotRerun(BaseException):
    """A component cannot be re-run, or not any further.

    Not an `Exception`, because it passes through the component's own call, which must not fail by
    it.
    """


class Sent(NamedTuple):
    """What was sent by a service: an answer or a request, or the text of a refusal.

    `gid` and `sequence` are those of the call that is answered; a request has only the latter.
    """

    gid: bytes
    sequence: int
    content: bytes | str


class CallEnvironment:
    """What happened during one recorded call, in queues from which the re-run takes it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.times: deque[int] = deque()
        self.subscribed: defaultdict[str, deque[bool]] = defaultdict(deque)
        self.sent: defaultdict[str, deque[MessageId]] = defaultdict(deque)
        self.pending: defaultdict[str, deque[MessageId]] = defaultdict(deque)
        self.pending_calls: defaultdict[str, deque[tuple[Any, ...]]] = defaultdict(deque)
        self.service_sent: defaultdict[str, deque[Sent]] = defaultdict(deque)
        self.outcomes: deque[str] = deque()
        self.is_cut = False
        self.end: Mapping[str, Any] | None = None

    def add(self, record: tuple[Any, ...], gids: dict[str, bytes]) -> None:
        """Add an event of the call; `gids` are the publishers of the outputs."""
        kind, *values = record
        match kind:
            case RecordKind.TIME:
                self.times.append(values[0])
            case RecordKind.HAS_SUBSCRIBERS | RecordKind.NO_SUBSCRIBERS:
                self.subscribed[values[0]].append(kind is RecordKind.HAS_SUBSCRIBERS)
            case RecordKind.OPENED:
                gids[values[0]] = values[1]
            case RecordKind.SENT | RecordKind.NOT_SENT:
                number = values[1] if kind is RecordKind.SENT else 0
                self.sent[values[0]].append(MessageId(gids.get(values[0], bytes(16)), number))
            case RecordKind.PENDING:
                self.pending[values[0]].append(MessageId(values[1], values[2]))
            case RecordKind.PENDING_CALL:
                self.pending_calls[values[0]].append(tuple(values[1:]))
            case RecordKind.REPLIED | RecordKind.REFUSED:
                self.service_sent[values[0]].append(Sent(values[1], values[2], values[3]))
            case RecordKind.REQUESTED:
                self.service_sent[values[0]].append(Sent(bytes(16), values[1], values[2]))
            case RecordKind.OUTCOME:
                self.outcomes.append(values[0])
            case RecordKind.ENDED:
                self.end = json.loads(values[0])
            case RecordKind.CUT:
                raise CannotRerun(f"the log ends: {values[0]}")
