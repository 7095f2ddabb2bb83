"""The recorded source: a console that plays a recording, and refuses what would steer a robot."""

from __future__ import annotations

import asyncio
import functools
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeVar

from pydantic import ConfigDict, Field

from cairn.bus.codec import Codec, to_plain
from cairn.console.browser import Browser
from cairn.console.monitoring import StateEvents
from cairn.console.operations import (
    LIVE_METHODS,
    Arguments,
    ConsoleMethod,
    OfComponent,
    OfRobot,
)
from cairn.console.protocol import ERROR
from cairn.console.recorded_parameters import PARAMETERS, attached_parameters, parameter_entries
from cairn.console.recorded_state import COLLECTED_TYPES, state_at
from cairn.console.source import Channel, ConnectionGraph, Message
from cairn.errors import CairnError
from cairn.recording.mcap_file import RecordedChannel, RecordedMessage
from cairn.recording.reader import McapRecording
from cairn.runtime.rosout import ROSOUT
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rcl_interfaces import Log
from cairn.system.clock import SECOND

if TYPE_CHECKING:
    from cairn.client.connection import Connection
    from cairn.console.hub import Hub

R = TypeVar("R")

_BATCH_MESSAGES: Final = 500
_BATCH_BYTES: Final = 8 << 20
_EVENT_S: Final = 0.1  # period of the event `playback`
_LATE_NS: Final = SECOND  # so much later than due, the clock waits for what is read
_STATES_S: Final = 1.0
_LOG_NS: Final = 120 * SECOND
_MOST_LOGS: Final = 2_000
_SLOWEST, _FASTEST = 0.01, 100.0


class RecordedSource:
    """Plays a recording for all browsers together. For the event loop's thread.

    Attributes:
        playing: whether time passes.
        speed: of time; 1 is as recorded.
        parameters: those that are attached, of each component by dotted name.
    """

    def __init__(self, paths: Path | Sequence[Path]) -> None:
        """Open a recording; `CairnError` if it cannot be read, or has no messages."""
        # All reading is done by this thread.
        self._reader = ThreadPoolExecutor(1, "cairn recording")
        self._recording = McapRecording(paths)
        if not self._recording.counts:
            raise CairnError(f"{self._recording.files[0]}: the recording has no messages")
        self._notes: list[str] = []
        self.parameters: dict[str, dict[str, Any]] = {}
        try:
            self.parameters = attached_parameters(self._recording)
        except CairnError as error:
            self._notes.append(str(error))
        self.playing = False
        self.speed = 1.0
        self._hub: Hub | None = None
        self._channels: dict[int, Channel] = {}
        self._recorded: defaultdict[int, list[RecordedChannel]] = defaultdict(list)
        self._ids: dict[RecordedChannel, int] = {}
        self._make_channels()
        self._position = self._recording.start_ns
        self._moved_at = 0.0  # when the position was right [s of the loop]
        self._subscribed: set[int] = set()
        self._unsent: set[int] = set()  # new subscriptions, which get the last messages
        self._kept: defaultdict[int, dict[RecordedChannel, Message]] = defaultdict(dict)
        self._pending: deque[RecordedMessage] = deque()
        self._messages: Iterator[RecordedMessage] | None = None
        self._is_stale = False  # the messages that are read are not those that are needed
        self._wake = asyncio.Event()

    @property
    def mode(self) -> Literal["live", "recording"]:
        """It is a recording."""
        return "recording"

    @property
    def recording(self) -> Mapping[str, Any]:
        """Its times, file, and remarks on what could not be read."""
        files = self._recording.files
        more = f" and {len(files) - 1} more" if len(files) > 1 else ""
        return {
            "start_ns": self._recording.start_ns,
            "end_ns": self._recording.end_ns,
            "file": f"{files[0].name}{more}",
            "notes": [*self._notes, *self._recording.notes][:20],
            "parameters": sorted(self.parameters),
        }

    @property
    def connection(self) -> Connection:
        """There is none."""
        raise CairnError("this is a recording, not a running robot")

    @property
    def now(self) -> int:
        """The time that is shown [ns]."""
        if not self.playing:
            return self._position
        passed_s = asyncio.get_running_loop().time() - self._moved_at
        return min(self._recording.end_ns, self._position + round(passed_s * self.speed * SECOND))

    def playback(self) -> dict[str, Any]:
        """Return the value of the event `playback`."""
        return {"playing": self.playing, "time_ns": self.now, "speed": self.speed}

    def set_playing(self, playing: bool) -> None:
        """Let time pass, or hold it; at the end it begins again."""
        at_end = self.now >= self._recording.end_ns
        if playing and not self.playing and at_end:
            self.seek(self._recording.start_ns)
        self._set_position(self.now)
        self.playing = playing

    def set_speed(self, speed: float) -> None:
        """Let time pass at a multiple of its speed."""
        self._set_position(self.now)
        self.speed = speed

    def seek(self, time_ns: int) -> None:
        """Go to a time; each subscription gets the messages that show its state then."""
        time_ns = min(max(time_ns, self._recording.start_ns), self._recording.end_ns)
        self._set_position(time_ns)
        self._unsent = set(self._subscribed)
        self._is_stale = True
        self._kept.clear()

    async def run(self, hub: Hub) -> None:
        """Report the channels, and play until canceled."""
        self._hub = hub
        hub.set_channels(self._channels.values())
        publishers: defaultdict[str, set[str]] = defaultdict(set)
        for one in self._ids:
            if one.node:
                publishers[one.topic].add(one.node)
        hub.set_graph(ConnectionGraph(publishers, {}))
        hub.set_link()
        try:
            await asyncio.gather(self._play(hub), self._report(hub))
        finally:
            self._reader.submit(self._recording.close)
            self._reader.shutdown(wait=False)

    def subscribe(self, channel: Channel) -> None:
        """Read a channel: its last messages, which show its state, first."""
        self._subscribed.add(channel.id)
        self._unsent.add(channel.id)
        self._set_position(self.now)
        self._is_stale = True

    def unsubscribe(self, channel: Channel) -> None:
        """Read a channel no longer."""
        self._subscribed.discard(channel.id)
        self._unsent.discard(channel.id)
        self._kept.pop(channel.id, None)
        self._set_position(self.now)
        self._is_stale = True

    def kept(self, channel: Channel) -> Sequence[Message]:
        """Return the last messages of a channel that is subscribed already."""
        if channel.type_name in COLLECTED_TYPES:  # read for all again
            self.subscribe(channel)
            return []
        return sorted(self._kept[channel.id].values())

    async def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        """Refuse it."""
        del type_name, payload
        raise CairnError(f"{topic} is not published: this is a recording, not a running robot")

    async def read(self, call: Callable[[McapRecording], R]) -> R:
        """Read from the recording on its thread."""
        loop = asyncio.get_running_loop()
        return await loop.run_in_executor(self._reader, functools.partial(call, self._recording))

    async def _play(self, hub: Hub) -> None:
        """Deliver the messages at their times."""
        while True:
            self._wake.clear()
            if self._is_stale or (not self._pending and self._messages is not None):
                try:
                    await (self._begin_again(hub) if self._is_stale else self._read_on())
                except CairnError as error:  # the file is damaged here, or was replaced
                    self._messages = None
                    self.set_playing(False)
                    for browser in hub.browsers:
                        browser.send_status(ERROR, str(error))
            else:
                self._deliver_due(hub)
                if self.playing and self.now >= self._recording.end_ns and not self._pending:
                    self._set_position(self._recording.end_ns)
                    self.playing = False
                await self._wait()

    async def _wait(self) -> None:
        """Wait until the next message is due, or something changes."""
        if not self.playing:
            await self._wake.wait()
            return
        until = self._pending[0].log_ns if self._pending else self._recording.end_ns
        wait_s = max(0.0, (until - self.now) / SECOND / self.speed)
        try:
            async with asyncio.timeout(min(wait_s, 1.0)):
                await self._wake.wait()
        except TimeoutError:
            return

    def _deliver_due(self, hub: Hub) -> None:
        now = self.now
        if self.playing and self._pending and now - self._pending[0].log_ns > _LATE_NS * self.speed:
            now = self._pending[0].log_ns  # reading takes longer than playing
            self._set_position(now)
        while self._pending and self._pending[0].log_ns <= now and not self._is_stale:
            self._deliver(hub, self._pending.popleft())

    def _deliver(self, hub: Hub, recorded: RecordedMessage) -> None:
        id_ = self._ids[recorded.channel]
        if id_ in self._subscribed:
            message = Message(recorded.log_ns, recorded.data)
            self._kept[id_][recorded.channel] = message
            hub.deliver(id_, message)

    async def _begin_again(self, hub: Hub) -> None:
        """Send the last messages of new subscriptions, and read on from the position."""
        self._is_stale = False
        self._pending.clear()
        position = self.now
        self._set_position(position)
        new, self._unsent = self._unsent, set()
        wanted = [one for id_ in sorted(self._subscribed) for one in self._recorded[id_]]
        asked = [one for id_ in sorted(new) for one in self._recorded[id_]]
        last: list[RecordedMessage] = []
        if asked:
            last = await self.read(lambda recording: state_at(recording, position, asked))
        if self._is_stale:
            self._unsent |= new & self._subscribed
            return
        for message in last:
            self._deliver(hub, message)
        self._messages = None
        if wanted:
            self._messages = await self.read(
                lambda recording: recording.messages(position + 1, channels=wanted)
            )

    async def _read_on(self) -> None:
        messages = self._messages
        assert messages is not None
        batch = await self.read(lambda _: _next_of(messages))
        if self._messages is messages and not self._is_stale:
            self._pending.extend(batch)
            if not batch:
                self._messages = None

    async def _report(self, hub: Hub) -> None:
        """Send the event `playback`, and the time to clients of Foxglove."""
        last: dict[str, Any] = {}
        while True:
            state = self.playback()
            if state != last:
                last = state
                hub.broadcast("playback", state)
                hub.broadcast_time(state["time_ns"])
            await asyncio.sleep(_EVENT_S)

    def _set_position(self, position: int) -> None:
        self._position = position
        self._moved_at = asyncio.get_running_loop().time()
        self._wake.set()

    def _make_channels(self) -> None:
        """Make one channel of those that several publishers have."""
        ids: dict[tuple[str, str, str], int] = {}
        for one in self._recording.channels:
            if one.encoding != "cdr":
                continue
            is_known = one.schema_encoding == "ros2msg"
            schema = one.schema.decode(errors="replace") if is_known else ""
            id_ = ids.setdefault((one.topic, one.type, schema), len(ids) + 1)
            self._ids[one] = id_
            self._recorded[id_].append(one)
            # `latched` here: each subscription gets the last messages.
            self._channels[id_] = Channel(id_, one.topic, one.type, schema, latched=True, depth=100)


def _next_of(messages: Iterator[RecordedMessage]) -> list[RecordedMessage]:
    """Return the next messages, up to 500 or 8 MiB; none at the end."""
    batch: list[RecordedMessage] = []
    size = 0
    for message in messages:
        batch.append(message)
        size += len(message.data)
        if len(batch) >= _BATCH_MESSAGES or size >= _BATCH_BYTES:
            break
    return batch


class Seek(Arguments):
    """A time in the recording [ns since 1970 UTC]."""

    time_ns: Annotated[int, Field(ge=0, lt=2**63)]


class Speed(Arguments):
    """How fast time passes; 1 is as recorded."""

    factor: Annotated[float, Field(ge=_SLOWEST, le=_FASTEST)]


class Nothing(Arguments):
    """No arguments; that of a robot is ignored."""

    robot: str = ""


class Anything(Arguments):
    """Any arguments: the method is refused."""

    model_config = ConfigDict(extra="allow")


class RecordedOperations:
    """The methods and events of a console that shows a recording."""

    def __init__(self, hub: Hub, source: RecordedSource) -> None:
        self._hub = hub
        self._source = source
        self._state = StateEvents(hub, lambda message: message.time_ns)
        methods = {name: _refused(name) for name in LIVE_METHODS}
        methods |= {
            "play": self._playback(Nothing, lambda _: source.set_playing(True)),
            "pause": self._playback(Nothing, lambda _: source.set_playing(False)),
            "seek": self._playback(Seek, lambda to: source.seek(to.time_ns)),
            "speed": self._playback(Speed, lambda to: source.set_speed(to.factor)),
            "logs": ConsoleMethod(OfRobot, self._logs, changes=False),
            "parameters": ConsoleMethod(OfComponent, self._parameters, changes=False),
        }
        self.methods: Mapping[str, ConsoleMethod] = methods

    async def run(self) -> None:
        """Send the events `components` and `topics`, until canceled."""
        shown = 0
        while True:
            now = self._source.now
            if now < shown:
                self._state.clear()
            shown = now
            self._state.update()
            self._state.send({}, now)
            await asyncio.sleep(_STATES_S)

    def connected(self, browser: Browser) -> None:
        """Send a new browser the state of the playback, and the last events."""
        if browser.is_console:
            self._hub.send_event(browser, "playback", self._source.playback())
            self._state.send_last(browser)

    def disconnected(self, _: Browser) -> None:
        """Hold the playback when the last browser is gone."""
        if not self._hub.browsers:
            self._source.set_playing(False)

    def refusal(self, browser: Browser, robot: str) -> str:
        """Return that nothing can be published."""
        del browser, robot
        return _REFUSAL

    def _playback(self, arguments: type[Arguments], change: Callable[[Any], None]) -> ConsoleMethod:
        """Return the method that changes the playback; its value is the new state."""

        async def call(_: Browser, given: Any) -> Any:
            change(given)
            return self._source.playback()

        return ConsoleMethod(arguments, call, changes=False)

    async def _logs(self, _: Browser, of: OfRobot) -> Any:
        now = self._source.now

        def read(recording: McapRecording) -> list[dict[str, Any]]:
            channels = [one for one in recording.counts if one.topic == ROSOUT]
            recorded = recording.messages(now - _LOG_NS, now, channels) if channels else ()
            return _log_entries(deque(recorded, maxlen=_MOST_LOGS), of.robot)

        return await self._source.read(read)

    async def _parameters(self, _: Browser, of: OfComponent) -> Any:
        found = self._source.parameters.get(of.component)
        if found is None:
            raise CairnError(f"{of.component}: the recording has no {PARAMETERS} of it")
        return parameter_entries(found)


_REFUSAL: Final = "this is a recording, not a running robot: it can be played, not steered"


def _refused(name: str) -> ConsoleMethod:
    async def refuse(_: Browser, __: Anything) -> Any:
        raise CairnError(f"{name}: {_REFUSAL}")

    return ConsoleMethod(Anything, refuse, changes=False)


def _log_entries(recorded: Sequence[RecordedMessage], robot: str) -> list[dict[str, Any]]:
    codec, entries = Codec(), []
    for message in recorded:
        try:
            entry = codec.decode(Log, message.data)
        except InvalidMessage:
            continue  # of a foreign node
        if entry.name.partition(".")[0] == robot:
            entries.append(to_plain(entry, None))
    return entries
