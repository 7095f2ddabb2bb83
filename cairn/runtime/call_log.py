"""The call log: what a component was called with, so that exactly these calls can be made again.

It is published if the deployment says so (`Deployment.has_call_log`), as topic
`<component>/call_log`, and recorded like any topic. `cairn.rerun` makes the calls again.
"""

import json
import threading
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from threading import get_ident
from typing import Any, Final

import numpy as np

from cairn.bus.bus import Call, MessageId, Node, ServiceError
from cairn.bus.qos import LATCHED
from cairn.errors import CairnError
from cairn.runtime.call_records import Record, RecordEncoder, RecordKind
from cairn.runtime.loop import Scheduler
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.cairn_msgs import CallBatch
from cairn.schemas.std_msgs import Header
from cairn.system.clock import Clock

CALL_LOG_QOS: Final = LATCHED.with_depth(20)
"""A recorder that starts a little later receives the log from its beginning all the same."""

_BATCH_BYTES: Final = 48_000
_MANY_RECORDS: Final = 4_000
"""So many records are published at once, without waiting for the next heartbeat."""
_MOST_HELD: Final = 100_000
"""Records kept until the component has discovered the recorder."""


def call_log_topic(component: str) -> str:
    """Return the name of a component's call log, below the robot's namespace."""
    return f"{component}/call_log"


class CallLog:
    """Logs the calls into one component.

    The component's calls add records; `flush`, from any thread, publishes them.
    """

    def __init__(
        self, node: Node, topic: str, component: str, incarnation: int, clock: Clock
    ) -> None:
        """Publish on `topic` (a full name); `clock` has the stamps of the batches."""
        from cairn.bus.codec import Codec  # imports rosbags: not for each `import cairn.Component`

        self.codec = Codec()
        self._publisher = node.advertise(topic, CallBatch, CALL_LOG_QOS)
        self._component = component
        self._incarnation = incarnation
        self._clock = clock
        self._started_ns = clock.now()
        self._encoder = RecordEncoder()
        self._records: deque[Record] = deque()
        self._published = 0
        self._depth = 0  # of calls in progress, one within another
        self._thread = 0  # which makes the call
        self._in_delivery = False
        self._open = True
        self._held = True
        self._full = False
        self._lock = threading.Lock()

    def call(self, record: Record, call: Callable[..., Any], *arguments: Any) -> Any:
        """Make a call, and log it unless it is made within another one."""
        self._begin()
        if self._depth == 1:
            self._records.append(record)
        try:
            return call(*arguments)
        finally:
            self._end()

    def deliver(self, call: Callable[[], None]) -> None:
        """Make the call for a received message; it is logged when it takes the message."""
        self._begin()
        self._in_delivery = True
        try:
            call()
        finally:
            self._in_delivery = False
            self._end()

    @property
    def in_call(self) -> bool:
        """Whether this thread makes a call into the component."""
        return self._depth > 0 and self._thread == get_ident()

    def add(self, *record: Any) -> None:
        """Log what happens during a call, unless it happens on another thread."""
        if self._depth and self._thread == get_ident():
            self._records.append(record)

    def took(self, port: str, message: MessageId | None) -> None:
        """Log that a port has taken a message."""
        kind = RecordKind.PENDING
        if self._in_delivery:
            self._in_delivery, kind = False, RecordKind.MESSAGE
        self._records.append((kind, port, *(message or MessageId(bytes(16), 0))))

    def called(self, port: str, call: Call) -> None:
        """Log that a server has taken a call."""
        kind = RecordKind.PENDING_CALL
        if self._in_delivery:
            self._in_delivery, kind = False, RecordKind.CALLED
        request = self.codec.encode(call.request)
        self._records.append((kind, port, call.client, call.sequence, request))

    def answered(self, port: str, sequence: int, answer: Any) -> None:
        """Log the answer to a client's call: a response, or a `ServiceError`."""
        self._in_delivery = False
        if isinstance(answer, ServiceError):
            self._records.append((RecordKind.FAILED, port, sequence, str(answer)))
        else:
            response = self.codec.encode(answer)
            self._records.append((RecordKind.ANSWERED, port, sequence, response))

    def clock_set(self, time: int) -> None:
        """Log that a message has set the component's clock [ns]."""
        self._in_delivery = False
        self._records.append((RecordKind.CLOCK, time))

    def connected(self) -> None:
        """Publish from now on: the component has discovered the other processes."""
        self._held = False

    def flush(self, *, last: bool = False) -> None:
        """Publish what was logged since the last call; with `last`, nothing more after it."""
        with self._lock:
            if not self._open or (self._held and not last):
                self._limit_held()
                return
            self._open = not last
            while self._records:
                self._publish_batch()
            if last:
                self._publisher.close()

    def _begin(self) -> None:
        if self._depth == 0:
            self._thread = get_ident()
        self._depth += 1

    def _end(self) -> None:
        self._depth -= 1
        if self._depth == 0 and len(self._records) >= _MANY_RECORDS:
            self.flush()

    def _limit_held(self) -> None:
        if len(self._records) > _MOST_HELD:
            self._records.clear()
            self._records.append((RecordKind.CUT, "too many calls before its activation"))

    def _publish_batch(self) -> None:
        data, count = bytearray(), 0
        while self._records and len(data) < _BATCH_BYTES:
            self._encoder.encode(self._records.popleft(), data)
            count += 1
        first, self._published = self._published, self._published + count
        self._publisher.publish(
            CallBatch(
                header=Header(stamp=from_ns(self._clock.now()), frame_id=""),
                component=self._component,
                incarnation=self._incarnation,
                started=from_ns(self._started_ns),
                first=first,
                count=count,
                records=np.frombuffer(bytes(data), np.uint8),
            )
        )


class LoggedClock:
    """A clock whose readings are logged."""

    def __init__(self, clock: Clock, log: CallLog) -> None:
        self._now = clock.now
        self._add = partial(log.add, RecordKind.TIME)

    def now(self) -> int:
        """Return the time [ns]."""
        time = self._now()
        self._add(time)
        return time


class LoggedScheduler:
    """A scheduler whose calls are logged."""

    def __init__(self, scheduler: Scheduler, log: CallLog) -> None:
        self._scheduler = scheduler
        self._log = log

    def post(self, call: Callable[[], None]) -> None:
        """Queue `call`."""
        kind = RecordKind.POSTED if self._log.in_call else RecordKind.FOREIGN
        self._scheduler.post(partial(self._log.call, (kind,), call))

    def deliver(self, call: Callable[[], None]) -> None:
        """Queue `call` for a received message."""
        self._scheduler.deliver(partial(self._log.deliver, call))

    def receive(self, call: Callable[[], None]) -> None:
        """Queue `call` for a received answer."""
        self._scheduler.receive(partial(self._log.deliver, call))

    def wake_at(self, time: int) -> None:
        """Run the due timers at `time` of the system clock [ns]."""
        self._scheduler.wake_at(time)

    def bind(self, on_time: Callable[[], None]) -> None:
        """Set the function that runs due timers."""
        self._scheduler.bind(partial(self._log.call, (RecordKind.TIMERS,), on_time))

    def stop(self) -> None:
        """Make no further calls."""
        self._scheduler.stop()


def request_record(verb: str, arguments: Mapping[str, Any]) -> Record:
    """Return the record of a control request; raises `CairnError` if it cannot be JSON."""
    try:
        return (RecordKind.REQUEST, verb, json.dumps(dict(arguments)))
    except (TypeError, ValueError) as error:
        raise CairnError(f"{verb}: the arguments of a request must be JSON: {error}") from error
