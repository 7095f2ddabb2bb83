"""Runs an emulated device on a line, on a thread of its own, with faults to order."""

from __future__ import annotations

import math
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextlib import suppress
from typing import Any, Protocol, TypeVar

import numpy as np

from cairn.driver.emulated_lines import LineEnd
from cairn.driver.emulated_outbox import Outbox
from cairn.driver.errors import LinkLost
from cairn.driver.faults import FrameFault, FrameFaults
from cairn.errors import CairnError

T = TypeVar("T")

_STOP_LIMIT_S = 5.0
_LOOK_S = 0.1  # how often it is looked whether the device still works, or a lost line is back


class EmulatedDevice(Protocol):
    """A device as its line shows it. It knows no line and no clock: time [s] is given, and grows.

    What it sends it gives in frames, each a whole message of its protocol.
    """

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take what the host has sent; what it answers at once.

        If it changes the line's speed, its answer still goes out at the old one.
        """
        ...

    def due(self) -> float:
        """When it next does something of its own accord [s]; infinite if never."""
        ...

    def tick(self, now: float) -> list[bytes]:
        """What it sends of its own accord; called when that is due, and oftener.

        Not called while nobody is there, or the line is busy with what was sent before: like a
        real device, it then goes on with what is newest.
        """
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
        self._outbox = Outbox(end, self._faults, paced=paced)
        self._hanging_until = -math.inf
        self._plugged = False
        self._returns_at = math.inf
        self._orders: deque[tuple[Callable[[], object], Future[Any]]] = deque()
        self._bell, self._ring = os.pipe()
        self._running = True
        self.bytes_heard = 0
        """What the host has sent, and was understood, so far."""
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="emulation", daemon=True)

    def __enter__(self) -> Emulation:
        """Switch it on and plug it in; raises `CairnError` if the line cannot be had."""
        try:
            self._plug_in()
        except CairnError:
            self._close_bell()
            raise
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Unplug it, and end its thread; raises what has failed in the device meanwhile."""
        with suppress(CairnError):  # what has failed is raised below
            self._do(self._end_all)
        self._thread.join(_STOP_LIMIT_S)
        self._end.unplug()
        self._close_bell()
        self.check()

    def check(self) -> None:
        """Raise what has failed in the device meanwhile, if anything has."""
        if self._failure is not None:
            raise self._failure

    def spoil(self, fault: FrameFault, frames: int = 1) -> None:
        """Have a fault befall so many of the next frames."""
        self._do(lambda: self._faults.order(fault, frames))

    def hang(self, seconds: float = math.inf) -> None:
        """Be silent and deaf for a time [s]; 0 ends it."""

        def begin() -> None:
            self._hanging_until = time.monotonic() + seconds
            self._outbox.clear()

        self._do(begin)

    def slow(self, baud: int | None) -> None:
        """Send no faster than that [bit/s] from now on; None: as before."""
        self._do(lambda: self._outbox.slow(baud))

    def unplug(self, seconds: float = math.inf) -> None:
        """Pull the plug; it is plugged in again after that time [s]."""

        def pull() -> None:
            self._pull()
            self._returns_at = time.monotonic() + seconds

        self._do(pull)

    def plug_in(self) -> None:
        """Plug it in again: it begins as after power-on."""
        self._do(self._plug_in)

    def ask(self, question: Callable[[], T]) -> T:
        """Have something done between the device's own steps, on its thread: what it returns.

        It may raise `CairnError`, which is raised here.
        """
        return self._do(question)

    @property
    def plugged_in(self) -> bool:
        """Whether it is on its line."""
        return self._plugged

    @property
    def frames_sent(self) -> int:
        """Frames that went onto the line, or were to, so far."""
        return self._outbox.frames_sent

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
        self._returns_at = math.inf

    def _pull(self) -> None:
        self._end.unplug()
        self._plugged = False
        self._outbox.clear()

    def _end_all(self) -> None:
        self._running = False

    def _close_bell(self) -> None:
        os.close(self._bell)
        os.close(self._ring)

    def _do(self, order: Callable[[], T]) -> T:
        done: Future[T] = Future()
        self._orders.append((order, done))
        os.write(self._ring, b"!")
        deadline = time.monotonic() + _STOP_LIMIT_S
        while not wait([done], _LOOK_S).done:
            if not self._thread.is_alive() or time.monotonic() > deadline:
                raise CairnError("the emulated device has failed") from self._failure
        return done.result()

    def _run(self) -> None:
        try:
            while self._running:
                self._turn()
        except BaseException as failure:  # told by `check`, or at the end
            self._failure = failure

    def _turn(self) -> None:
        self._wait()
        self._follow_orders()
        try:
            if time.monotonic() >= self._returns_at:
                self._plug_in()
            if self._plugged and self._running:
                self._serve()
        except LinkLost:  # a real line may be gone, and come back
            self._pull()
            self._returns_at = time.monotonic() + _LOOK_S

    def _serve(self) -> None:
        self._listen()
        now = time.monotonic()
        if now < self._hanging_until:
            return
        if not self._outbox and self._end.writable() is not None:
            baud = self._device.baud()
            self._end.set_baud(baud)
            self._outbox.add(self._device.tick(now), baud, now)
        self._outbox.flush(now)

    def _wait(self) -> None:
        """Sleep until there is something to do."""
        now = time.monotonic()
        writable = self._end.writable()
        sending: list[int] = []
        if not self._plugged:
            next_at = self._returns_at
        elif now < self._hanging_until:
            next_at = self._hanging_until
        elif writable is None:
            next_at = math.inf
        elif not self._outbox:
            next_at = self._device.due()
        elif self._outbox.free_at > now:
            next_at = self._outbox.free_at
        else:
            next_at, sending = math.inf, [writable]
        limit = max(0.0, next_at - now) if math.isfinite(next_at) else None
        select.select([self._bell, *self._end.readable()], sending, [], limit)

    def _follow_orders(self) -> None:
        while self._orders:
            os.read(self._bell, 1)
            order, done = self._orders.popleft()
            try:
                done.set_result(order())
            except CairnError as error:
                done.set_exception(error)

    def _listen(self) -> None:
        now = time.monotonic()
        data = self._end.take()
        baud = self._device.baud()
        if data is None:
            self._outbox.clear()
            self._device.hung_up(now)
        elif data and now >= self._hanging_until and self._understood(baud):
            self.bytes_heard += len(data)
            self._outbox.add(self._device.receive(data, now), baud, now)

    def _understood(self, baud: int | None) -> bool:
        spoken = self._end.baud()
        return None in (spoken, baud) or spoken == baud
