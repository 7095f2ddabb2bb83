"""Runs an emulated device on a line, on a thread of its own, with faults to order."""

from __future__ import annotations

import math
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np

from cairn.driver.emulated_lines import LineEnd
from cairn.driver.faults import FrameFault, FrameFaults
from cairn.errors import CairnError

_BUFFER = 262_144  # bytes that a device keeps for a host that does not read; then frames are lost
_STOP_LIMIT_S = 5.0
_BITS_PER_BYTE = 10  # start, eight of data, stop


class EmulatedDevice(Protocol):
    """A device as its line shows it. It knows no line and no clock: time [s] is given, and grows.

    What it sends it gives in frames, each a whole message of its protocol.
    """

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take what the host has sent; what it answers at once."""
        ...

    def due(self) -> float:
        """When it next does something of its own accord [s]; infinite if never."""
        ...

    def tick(self, now: float) -> list[bytes]:
        """What it sends of its own accord; called when that is due, and oftener."""
        ...

    def hung_up(self, now: float) -> None:
        """Take note that the host has closed the line, where a line tells that."""
        ...

    def switched_on(self, now: float) -> None:
        """Begin as after power-on: it was plugged in."""
        ...

    def baud(self) -> int | None:
        """The speed at which it speaks [bit/s]; None if it does not matter."""
        ...


class Emulation:
    """An emulated device, plugged into a line. A context manager: `with Emulation(...) as it:`.

    All methods may be called from any thread; what they order has happened when they return.
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
        """`shares` of frames that faults befall [1]; `paced`: bytes take the time that the line's
        speed gives them, as on a real serial line.
        """
        self._device = device
        self._end = end
        self._faults = FrameFaults(shares or {}, np.random.default_rng(seed))
        self._paced = paced
        self._slow: int | None = None
        self._free_at = 0.0  # when the line has sent what it was given
        self._pending: deque[bytes] = deque()
        self._hanging_until = -math.inf
        self._plugged = False
        self._orders: deque[tuple[Callable[[], None], threading.Event]] = deque()
        self._bell, self._ring = os.pipe()
        self._running = True
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="emulation", daemon=True)

    def __enter__(self) -> Emulation:
        """Switch it on and plug it in; raises `CairnError` if the line cannot be had."""
        self._plug_in()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Unplug it, and end its thread; raises what has failed in the device meanwhile."""
        if self._thread.is_alive():
            self._do(self._end_all)
        self._thread.join(_STOP_LIMIT_S)
        self._end.unplug()
        os.close(self._bell)
        os.close(self._ring)
        if self._failure is not None:
            raise self._failure

    def spoil(self, fault: FrameFault, frames: int = 1) -> None:
        """Have a fault befall so many of the next frames."""
        self._do(lambda: self._faults.order(fault, frames))

    def hang(self, seconds: float = math.inf) -> None:
        """Be silent and deaf for a time [s]; 0 ends it."""

        def begin() -> None:
            self._hanging_until = time.monotonic() + seconds
            self._pending.clear()

        self._do(begin)

    def slow(self, baud: int | None) -> None:
        """Send no faster than that [bit/s] from now on; None: as before."""

        def begin() -> None:
            self._slow = baud
            self._free_at = 0.0

        self._do(begin)

    def unplug(self) -> None:
        """Pull the plug."""

        def pull() -> None:
            self._end.unplug()
            self._plugged = False
            self._pending.clear()

        self._do(pull)

    def plug_in(self) -> None:
        """Plug it in again: it begins as after power-on."""
        self._do(self._plug_in)

    def ask(self, question: Callable[[], None]) -> None:
        """Have something done between the device's own steps, on its thread."""
        self._do(question)

    @property
    def spoilt(self) -> dict[str, int]:
        """How many frames each fault has befallen so far."""
        return dict(self._faults.done)

    def _plug_in(self) -> None:
        if self._plugged:
            return
        self._end.plug_in()
        self._device.switched_on(time.monotonic())
        self._plugged = True

    def _end_all(self) -> None:
        self._running = False

    def _do(self, order: Callable[[], None]) -> None:
        done = threading.Event()
        self._orders.append((order, done))
        os.write(self._ring, b"!")
        if not done.wait(_STOP_LIMIT_S) or self._failure is not None:
            raise CairnError("the emulated device has failed") from self._failure

    def _run(self) -> None:
        try:
            while self._running:
                self._turn()
        except BaseException as failure:  # told by the next order, or at the end
            self._failure = failure
        while self._orders:
            self._orders.popleft()[1].set()

    def _turn(self) -> None:
        now = time.monotonic()
        silent = not self._plugged or now < self._hanging_until
        waits = [self._hanging_until - now] if silent else [self._device.due() - now]
        writable = None if silent else self._end.writable()
        sending = []
        if self._pending and writable is not None:
            if self._free_at <= now:
                sending = [writable]
            else:
                waits.append(self._free_at - now)
        wait = min((max(0.0, one) for one in waits if math.isfinite(one)), default=None)
        select.select([self._bell, *self._end.readable()], sending, [], wait)
        self._follow_orders()
        if not self._plugged or not self._running:
            return
        self._listen()
        now = time.monotonic()
        if now >= self._hanging_until:
            self._send(self._device.tick(now))
            self._flush(now)

    def _follow_orders(self) -> None:
        while self._orders:
            os.read(self._bell, 1)
            order, done = self._orders.popleft()
            try:
                order()
            finally:
                done.set()

    def _listen(self) -> None:
        now = time.monotonic()
        data = self._end.take()
        if data is None:
            self._pending.clear()
            self._device.hung_up(now)
        elif data and now >= self._hanging_until and self._same_speed():
            self._send(self._device.receive(data, now))

    def _same_speed(self) -> bool:
        spoken, heard = self._end.baud(), self._device.baud()
        return spoken is None or heard is None or spoken == heard

    def _send(self, frames: list[bytes]) -> None:
        for frame in frames:
            if sum(map(len, self._pending)) < _BUFFER and self._end.writable() is not None:
                self._pending.append(self._faults.spoil(frame))

    def _flush(self, now: float) -> None:
        """Give the line what it takes now; at the wrong speed nothing of it can be understood."""
        while self._pending and self._free_at <= now:
            frame = self._pending.popleft()
            baud = self._slow or (self._device.baud() if self._paced else None)
            part = frame if baud is None else frame[: max(1, baud // (_BITS_PER_BYTE * 100))]
            given = self._end.give(part if self._same_speed() else bytes(len(part)))
            if given < len(frame):
                self._pending.appendleft(frame[given:])
            if baud is not None:
                self._free_at = max(self._free_at, now - 0.1) + given * _BITS_PER_BYTE / baud
            if given < len(part):
                return
