"""The emulator: runs an emulated device on a line, on a thread of its own, and injects faults."""

from __future__ import annotations

import math
import os
import select
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar, get_args

import numpy as np

from cairn.driver.emulator_lines import LineEnd
from cairn.driver.errors import LinkLost
from cairn.errors import CairnError

T = TypeVar("T")

FrameFault = Literal["bad_sum", "cut", "garbage", "drop"]
"""What may happen to a frame: a bit is flipped, a part is missing, noise precedes it, or it is not
sent at all."""

FRAME_FAULTS: tuple[FrameFault, ...] = get_args(FrameFault)

_STOP_TIMEOUT_S = 5.0
_POLL_S = 0.1  # how often a lost real line is opened again, and the thread is checked
_SEND_BUFFER_BYTES = 65_536  # kept for a host that does not read; the rest is lost
_BITS_PER_BYTE = 10  # start, eight of data, stop
_PORTIONS_PER_S = 100  # a paced line is given what it sends in 10 ms at a time


class EmulatedDevice(Protocol):
    """A device as seen on its line. It has no line and no clock: time [s] is passed, and grows.

    It returns what it sends as frames, each a whole message of its protocol.
    """

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take bytes from the host; return the frames that answer at once.

        If that changes the line's speed, the answer is still sent at the old one.
        """

    def due(self) -> float:
        """Return when it next sends something by itself [s]; infinite if never."""

    def tick(self, now: float) -> list[bytes]:
        """Return the frames that it sends by itself; called when they are due, and more often.

        Not called while no host is connected, or while the line is busy with earlier frames: like a
        real device, it continues with the newest data then.
        """

    def disconnected(self, now: float) -> None:
        """Handle that the host has closed the line, where a line shows that."""

    def powered_on(self, now: float) -> None:
        """Start as after power-on: it was plugged in."""

    def baud(self) -> int | None:
        """Return the speed of its line [bit/s]; None if it does not matter.

        The emulator sets a real serial port to it. On a pseudo-terminal, which has no speed of its
        own, it compares it with the speed that the host has set: a host at another speed receives
        zeros, and what it sends is lost. A device whose speed can be changed by a command returns
        the new speed from then on.
        """


class Emulator:
    """Runs an emulated device on a line. A context manager: `with Emulator(...) as emulator:`.

    All methods may be called from any thread; when they return, it has happened.
    """

    def __init__(
        self,
        device: EmulatedDevice,
        end: LineEnd,
        *,
        shares: dict[FrameFault, float] | None = None,
        paced: bool = False,
        seed: int = 0,
    ) -> None:
        """Prepare the emulator; nothing runs yet.

        Args:
            device: what to emulate.
            end: the device's end of a line.
            shares: share of all frames that each fault is injected into [1].
            paced: bytes take the time that the line's speed gives them, as on a real serial line.
            seed: of the faults.
        """
        self._device = device
        self._end = end
        self._faults = FrameFaults(shares or {}, np.random.default_rng(seed))
        self._queue = _SendQueue(end, self._faults, paced=paced)
        self._hangs_until = -math.inf
        self.plugged_in = False  # connected to its line
        self._returns_at = math.inf
        self._calls: deque[tuple[Callable[[], object], Future[Any]]] = deque()
        self._wake_read, self._wake_write = os.pipe()
        self._running = True
        self.bytes_received = 0
        """Bytes that the host has sent at the right speed so far."""
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="emulator", daemon=True)

    def __enter__(self) -> Emulator:
        """Power the device on and plug it in; raises `CairnError` if the line cannot be opened."""
        try:
            self._plug_in()
        except CairnError:
            self._close_pipe()
            raise
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Unplug the device and stop the thread; raises the device's failure, if it has failed."""
        with suppress(CairnError):  # what has failed is raised below
            self.call(self._stop)
        self._thread.join(_STOP_TIMEOUT_S)
        self._end.unplug()
        self._close_pipe()
        self.check()

    def check(self) -> None:
        """Raise the device's failure, if it has failed."""
        if self._failure is not None:
            raise self._failure

    def inject(self, fault: FrameFault, frames: int = 1) -> None:
        """Inject a fault into the next frames."""
        self.call(lambda: self._faults.schedule(fault, frames))

    def hang(self, seconds: float = math.inf) -> None:
        """Neither send nor receive for this time [s]; 0 ends it."""

        def hang() -> None:
            self._hangs_until = time.monotonic() + seconds
            self._queue.clear()

        self.call(hang)

    def slow(self, baud: int | None) -> None:
        """Send no faster than this [bit/s] from now on; None: as before."""
        self.call(lambda: self._queue.limit(baud))

    def unplug(self, seconds: float = math.inf) -> None:
        """Unplug the device; it is plugged in again after this time [s]."""

        def pull() -> None:
            self._pull()
            self._returns_at = time.monotonic() + seconds

        self.call(pull)

    def plug_in(self) -> None:
        """Plug the device in again: it starts as after power-on."""
        self.call(self._plug_in)

    def call(self, function: Callable[[], T]) -> T:
        """Call a function on the device's thread, between its steps; return what it returns.

        A `CairnError` that it raises is raised here. Raises `CairnError` if the device has failed.
        """
        done: Future[T] = Future()
        self._calls.append((function, done))
        os.write(self._wake_write, b"!")
        deadline = time.monotonic() + _STOP_TIMEOUT_S
        while not wait([done], _POLL_S).done:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                raise CairnError("the emulated device has failed") from self._failure
        return done.result()

    @property
    def frames_sent(self) -> int:
        """Frames that were sent, or would have been without a fault, so far."""
        return self._queue.frames_sent

    @property
    def injected(self) -> dict[str, int]:
        """How many frames each fault was injected into so far."""
        return dict(self._faults.counts)

    def _plug_in(self) -> None:
        if self.plugged_in:
            return
        self._end.plug_in()
        self._device.powered_on(time.monotonic())
        self.plugged_in = True
        self._returns_at = math.inf

    def _pull(self) -> None:
        self._end.unplug()
        self.plugged_in = False
        self._queue.clear()

    def _stop(self) -> None:
        self._running = False

    def _close_pipe(self) -> None:
        os.close(self._wake_read)
        os.close(self._wake_write)

    def _run(self) -> None:
        try:
            while self._running:
                self._turn()
        except BaseException as failure:  # raised by `check`, or at the end of the context
            self._failure = failure

    def _turn(self) -> None:
        self._wait()
        self._make_calls()
        try:
            if time.monotonic() >= self._returns_at:
                self._plug_in()
            if self.plugged_in and self._running:
                self._serve()
        except LinkLost:  # a real line may be gone, and come back
            self._pull()
            self._returns_at = time.monotonic() + _POLL_S

    def _serve(self) -> None:
        self._receive()
        now = time.monotonic()
        if now < self._hangs_until:
            return
        if not self._queue and self._end.writable() is not None:
            baud = self._device.baud()
            self._end.set_baud(baud)
            self._queue.add(self._device.tick(now), baud, now)
        self._queue.flush(now)

    def _wait(self) -> None:
        """Wait until there is something to do."""
        now = time.monotonic()
        writable = self._end.writable()
        sending: list[int] = []
        if not self.plugged_in:
            next_at = self._returns_at
        elif now < self._hangs_until:
            next_at = self._hangs_until
        elif writable is None:
            next_at = math.inf
        elif not self._queue:
            next_at = self._device.due()
        elif self._queue.free_at > now:
            next_at = self._queue.free_at
        else:
            next_at, sending = math.inf, [writable]
        timeout = max(0.0, next_at - now) if math.isfinite(next_at) else None
        select.select([self._wake_read, *self._end.readable()], sending, [], timeout)

    def _make_calls(self) -> None:
        while self._calls:
            os.read(self._wake_read, 1)
            function, done = self._calls.popleft()
            try:
                done.set_result(function())
            except CairnError as error:
                done.set_exception(error)

    def _receive(self) -> None:
        now = time.monotonic()
        data = self._end.read()
        baud = self._device.baud()
        if data is None:
            self._queue.clear()
            self._device.disconnected(now)
        elif data and now >= self._hangs_until and _same_speed(self._end.baud(), baud):
            self.bytes_received += len(data)
            self._queue.add(self._device.receive(data, now), baud, now)


class FrameFaults:
    """Damages frames: the next ones as scheduled, and a share of all at random."""

    def __init__(self, shares: dict[FrameFault, float], random: np.random.Generator) -> None:
        """`shares`: share of all frames that each fault is injected into [1]."""
        self._shares = shares
        self._random = random
        self._scheduled: list[FrameFault] = []
        self.counts: Counter[str] = Counter()
        """How many frames each fault was injected into."""

    def schedule(self, fault: FrameFault, frames: int = 1) -> None:
        """Inject a fault into the next frames."""
        self._scheduled += [fault] * frames

    def apply(self, frame: bytes) -> bytes:
        """Return what is sent of a frame, after the faults that are due."""
        for fault in self._due():
            self.counts[fault] += 1
            frame = self._damaged(fault, frame)
        return frame

    def _due(self) -> list[FrameFault]:
        due = [self._scheduled.pop(0)] if self._scheduled else []
        chance = {fault: share for fault, share in self._shares.items() if share > 0}
        return due + [fault for fault, share in chance.items() if self._random.random() < share]

    def _damaged(self, fault: FrameFault, frame: bytes) -> bytes:
        if not frame:
            return frame
        at = int(self._random.integers(len(frame)))
        match fault:
            case "bad_sum":
                wrong = frame[at] ^ (1 << int(self._random.integers(8)))
                return frame[:at] + bytes([wrong]) + frame[at + 1 :]
            case "cut":
                return frame[:at] + frame[at + 1 + int(self._random.integers(len(frame) - at)) :]
            case "garbage":
                return self._random.bytes(1 + int(self._random.integers(200))) + frame
            case "drop":
                return b""


@dataclass(frozen=True)
class _Frame:
    """Bytes to be sent, and the speed to send them at [bit/s], if that matters."""

    data: bytes
    baud: int | None


class _SendQueue:
    """Frames that wait until the line takes them."""

    def __init__(self, end: LineEnd, faults: FrameFaults, *, paced: bool) -> None:
        self._end = end
        self._faults = faults
        self._paced = paced
        self._limit: int | None = None
        self._frames: deque[_Frame] = deque()
        self.free_at = 0.0
        """When the line has sent what it was given [s]."""
        self.frames_sent = 0

    def __bool__(self) -> bool:
        """Whether a frame waits."""
        return bool(self._frames)

    def limit(self, baud: int | None) -> None:
        """Send no faster than this [bit/s] from now on; None: as before."""
        self._limit = baud
        self.free_at = 0.0

    def clear(self) -> None:
        """Discard the frames that wait."""
        self._frames.clear()

    def add(self, frames: list[bytes], baud: int | None, now: float) -> None:
        """Queue frames for a speed [bit/s]; they are lost if no host is connected."""
        if not self._frames:
            self.free_at = max(self.free_at, now)  # an idle line cannot send in the past
        for data in frames:
            waiting = sum(len(frame.data) for frame in self._frames)
            if waiting < _SEND_BUFFER_BYTES and self._end.writable() is not None:
                self.frames_sent += 1
                self._frames.append(_Frame(self._faults.apply(data), baud))

    def flush(self, now: float) -> None:
        """Write what the line takes now; at the wrong speed the host receives zeros instead."""
        while self._frames and self.free_at <= now:
            frame = self._frames.popleft()
            pace = self._limit or (frame.baud if self._paced else None)
            portion = _BITS_PER_BYTE * _PORTIONS_PER_S
            part = frame.data if pace is None else frame.data[: max(1, pace // portion)]
            readable = _same_speed(self._end.baud(), frame.baud)
            written = self._end.write(part if readable else bytes(len(part)))
            if written < len(frame.data):
                self._frames.appendleft(_Frame(frame.data[written:], frame.baud))
            if pace is not None:
                self.free_at = max(self.free_at, now - 0.1) + written * _BITS_PER_BYTE / pace
            if written < len(part):
                return


def _same_speed(line: int | None, device: int | None) -> bool:
    """Whether both ends of a line use the same speed [bit/s]; None: it does not matter."""
    return line is None or device is None or line == device
