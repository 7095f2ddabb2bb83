"""The messages that a re-run uses, read from its recording as it proceeds."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from cairn.bus.bus import MessageId
from cairn.recording.mcap_file import RecordedChannel
from cairn.recording.reader import McapRecording
from cairn.rerun.call_environment import CannotRerun
from cairn.rerun.call_logs import ComponentStart
from cairn.rerun.engine import Payload
from cairn.runtime.call_records import Record, RecordKind

_KEPT_BYTES: Final = 512 << 20
_LOW_32: Final = 0xFFFF_FFFF


def add_uses(
    records: Iterable[Record], uses: Counter[MessageId] | set[MessageId], gids: dict[str, bytes]
) -> None:
    """Add the messages that records use; `gids` has the publishers of the outputs so far."""
    for kind, *values in records:
        match kind:
            case RecordKind.MESSAGE | RecordKind.PENDING:
                identity = MessageId(values[1], values[2] & _LOW_32)
            case RecordKind.OPENED:
                gids[values[0]] = values[1]
                continue
            case RecordKind.SENT:
                identity = MessageId(gids.get(values[0], b""), values[1] & _LOW_32)
            case _:
                continue
        if isinstance(uses, set):
            uses.add(identity)
        else:
            uses[identity] += 1


@dataclass(frozen=True)
class NeededMessages:
    """The messages that the re-run of a start uses, with how often, by publisher and number."""

    uses: Counter[MessageId]
    has_foreign_calls: bool
    publishes: bool


def needed_messages(start: ComponentStart) -> NeededMessages:
    """Return which messages a start needs; raises `RecordingError` if its log is damaged."""
    uses: Counter[MessageId] = Counter()
    gids: dict[str, bytes] = {}
    foreign = publishes = False
    for record in start.records():
        add_uses((record,), uses, gids)
        publishes = publishes or record[0] is RecordKind.SENT
        foreign = foreign or record[0] is RecordKind.FOREIGN
    return NeededMessages(uses, foreign, publishes)


class StreamedMessages:
    """The messages that a re-run needs, read from the recording as it proceeds."""

    def __init__(self, recording: McapRecording, needed: NeededMessages) -> None:
        self._left = needed.uses.copy()
        gids = {one.gid for one in self._left}
        channels = [one for one in recording.channels if _gid(one) in gids]
        self._stream = recording.messages(channels=channels) if channels else iter(())
        self._kept: dict[MessageId, Payload] = {}
        self._kept_bytes = 0
        self._newest: dict[bytes, int] = {}

    def find(self, message: MessageId) -> Payload | None:
        """Return a message; None if it was not recorded."""
        wanted = MessageId(message.gid, message.sequence & _LOW_32)
        while wanted not in self._kept:
            if self._newest.get(wanted.gid, -1) >= wanted.sequence or not self._read():
                return None
        payload = self._kept[wanted]
        self._left[wanted] -= 1
        if self._left[wanted] <= 0:
            del self._kept[wanted]
            self._kept_bytes -= len(payload.data)
        return payload

    def _read(self) -> bool:
        """Read one message; return False at the end of the recording."""
        one = next(self._stream, None)
        if one is None:
            return False
        identity = MessageId(_gid(one.channel), one.sequence)
        self._newest[identity.gid] = max(one.sequence, self._newest.get(identity.gid, 0))
        if self._left[identity] > 0 and identity not in self._kept:
            self._kept[identity] = Payload(one.data, one.channel.type_hash, one.publish_ns)
            self._kept_bytes += len(one.data)
            if self._kept_bytes > _KEPT_BYTES:
                raise CannotRerun(
                    f"more than {_KEPT_BYTES >> 20} MiB of messages wait for calls that use them"
                )
        return True


def _gid(channel: RecordedChannel) -> bytes:
    try:
        return bytes.fromhex(channel.gid)
    except ValueError:
        return b""
