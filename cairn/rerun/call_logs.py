"""The call logs of a recording: one for each start of a component, as far as it is complete."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final

from pydantic import ValidationError

from cairn.errors import RecordingError
from cairn.runtime.call_records import CallLogError, Record, RecordDecoder, RecordKind, StartInfo
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.cairn_msgs import CallBatch

MOST_STARTS: Final = 10_000
LOG_BYTES: Final = 1 << 30
"""Longest call logs of a recording, of all starts together."""


@dataclass
class RecordedCall:
    """One call into a component: the record with which it begins, and what happened during it.

    `time_ns` is the first time that is known of it, else the last one before it.
    """

    record: Record
    events: list[Record]
    time_ns: int

    @property
    def kind(self) -> RecordKind:
        """What kind of call it is."""
        kind: RecordKind = self.record[0]
        return kind

    @property
    def description(self) -> str:
        """What call it is, for reports."""
        values = self.record[1:]
        match self.kind:
            case RecordKind.START:
                return "its start"
            case RecordKind.TRANSITION:
                return f"transition {values[0]}"
            case RecordKind.MESSAGE:
                return f"the handler of {values[0]}, message {values[2]}"
            case RecordKind.CALLED:
                return f"the server {values[0]}, call {values[2]}"
            case RecordKind.ANSWERED | RecordKind.FAILED:
                return f"the answer to call {values[1]} of {values[0]}"
            case RecordKind.CLOCK:
                return "a message on topic clock"
            case RecordKind.TIMERS:
                return "a timer"
            case RecordKind.REQUEST:
                return f"request {values[0]}"
            case RecordKind.HOST:
                return f"a call of its host ({values[0]})"
            case _:
                return "a posted call"


@dataclass
class ComponentStart:
    """One start of a component, with its call log as far as it was recorded.

    `missing` says what is missing of the log, "" if nothing is.
    """

    component: str
    incarnation: int
    started_ns: int
    _parts: dict[int, tuple[int, bytes]] = field(default_factory=dict)

    def add(self, batch: CallBatch) -> None:
        """Add a part of the log; one that is there already has no effect."""
        self._parts.setdefault(batch.first, (batch.count, batch.records.tobytes()))

    def contains(self, batch: CallBatch, records: int) -> bool:
        """Return whether a batch is of this start, and begins within the first `records`."""
        which = (batch.component, batch.incarnation, to_ns(batch.started))
        return (
            which == (self.component, self.incarnation, self.started_ns) and batch.first < records
        )

    @property
    def missing(self) -> str:
        """What is missing of the log, "" if nothing is."""
        end = self._end()
        if end == 0:
            return "the log does not begin with its start"
        later = [first for first in self._parts if first >= end]
        if later:
            return f"records {end} to {min(later) - 1} of the log were not recorded"
        return ""

    def records(self) -> Iterator[Record]:
        """Yield the records from the start on, as far as none is missing.

        Raises `RecordingError` if the log is damaged.
        """
        decoder, at, last = RecordDecoder(), 0, self._end()
        while at < last:
            count, data = self._parts[at]
            found = 0
            try:
                for record in decoder.decode(data):
                    found += 1
                    yield record
            except CallLogError as error:
                raise RecordingError(
                    f"{self.component}: its call log is damaged: {error}"
                ) from error
            if found != count:
                raise RecordingError(
                    f"{self.component}: its call log is damaged: a part has {found} records, not "
                    f"{count}"
                )
            at += count

    def calls(self) -> Iterator[RecordedCall]:
        """Yield the calls in order; raises `RecordingError` if the log is damaged."""
        call: RecordedCall | None = None
        last_ns, timed = self.started_ns, False
        for record in self.records():
            kind = record[0]
            if kind is RecordKind.CLOCK or kind is RecordKind.TIME:
                last_ns = record[1]
            if kind.begins_call:
                if call is not None:
                    yield call
                call, timed = RecordedCall(record, [], last_ns), kind is RecordKind.CLOCK
                continue
            if call is None:
                raise RecordingError(f"{self.component}: its call log does not begin with a call")
            if kind is RecordKind.TIME and not timed:
                call.time_ns, timed = last_ns, True
            call.events.append(record)
        if call is not None:
            yield call

    def info(self) -> StartInfo:
        """Return with what it was started; raises `RecordingError` if the log does not have it."""
        record = next(self.records(), None)
        if record is None or record[0] is not RecordKind.START:
            raise RecordingError(f"{self.component}: {self.missing or 'its call log is damaged'}")
        try:
            return StartInfo.model_validate(json.loads(record[1]))
        except (ValueError, ValidationError) as error:
            raise RecordingError(
                f"{self.component}: the start in its call log is damaged: {error}"
            ) from error

    def _end(self) -> int:
        """Return the number of the first record that is missing, or would be the next one."""
        at = 0
        while at in self._parts and self._parts[at][0] > 0:
            at += self._parts[at][0]
        return at


def component_starts(batches: Iterable[CallBatch]) -> list[ComponentStart]:
    """Return the starts of all components in order of time."""
    starts: dict[tuple[str, int, int], ComponentStart] = {}
    size = 0
    for batch in batches:
        size += batch.records.nbytes
        if size > LOG_BYTES:
            raise RecordingError(
                f"the call logs have more than {LOG_BYTES:,} bytes; cut the recording with "
                "`cairn recording cut`"
            )
        key = (batch.component, to_ns(batch.started), batch.incarnation)
        if key not in starts:
            if len(starts) >= MOST_STARTS:
                raise RecordingError(f"the recording has more than {MOST_STARTS:,} starts")
            starts[key] = ComponentStart(batch.component, batch.incarnation, key[1])
        starts[key].add(batch)
    return sorted(starts.values(), key=lambda one: (one.started_ns, one.component))
