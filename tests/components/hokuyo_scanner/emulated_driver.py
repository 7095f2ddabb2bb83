"""The driver and an emulated sensor at the ends of a line; compares published with sent scans."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn import RELIABLE, every
from cairn.bus.lockstep_bus import LockstepBus
from cairn.components.hokuyo_scanner.component import HokuyoScanner
from cairn.components.hokuyo_scanner.emulator import EmulatedScip
from cairn.components.hokuyo_scanner.emulator_sensor import SentScan
from cairn.driver.emulator import Emulator
from cairn.driver.emulator_lines import LineEnd, PtyEnd, TcpEnd
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan, MultiEchoLaserScan
from tests.cairn.runtime.threaded import ThreadedComponent
from tests.patience import LIMIT_S

_ALL = RELIABLE.with_depth(1_000_000)
_NEVER_S = 60.0
"""Silence that no test reaches, however busy the machine: the longest one allowed [s]."""

REPLY_TIMEOUT_S = 0.5
"""The driver's own time limit for a reply [s], for sensors that leave some commands unanswered."""

_LIMITS = {"URG": (20, 5600), "UTM": (23, 60000), "UST": (20, 30000)}
_SHORT_MOST = 4094
_CODES = {1: math.inf, 2: -math.inf}  # of UTM and UST: nothing hit, too near


class Received:
    """Collects all messages of one topic."""

    def __init__(self, bus: LockstepBus, topic: str, message: type[Any]) -> None:
        self._messages: list[Any] = []
        self._changed = threading.Condition()
        node = bus.node(f"/observer/{topic}", lambda complaint: None)
        self._subscription = node.subscribe(f"/robot/{topic}", message, _ALL, self._take)

    def _take(self) -> None:
        with self._changed:
            self._messages.append(self._subscription.take())
            self._changed.notify_all()

    def __len__(self) -> int:
        return len(self._messages)

    def all(self) -> list[Any]:
        """Return the messages so far."""
        with self._changed:
            return list(self._messages)

    def wait(self, number: int, after: int = 0) -> list[Any]:
        """Wait for `number` messages after the first `after`; return these."""
        return self.wait_for(lambda messages: len(messages) >= after + number)[
            after : after + number
        ]

    def wait_for(self, enough: Callable[[list[Any]], bool], limit_s: float = LIMIT_S) -> list[Any]:
        """Wait until `enough` holds of all messages so far; return them."""
        deadline = time.monotonic() + limit_s
        with self._changed:
            while not enough(self._messages):
                left_s = deadline - time.monotonic()
                assert left_s > 0, f"after {limit_s:g} s only {len(self._messages)} received"
                self._changed.wait(left_s)
            return list(self._messages)


class FrequentReporter(HokuyoScanner):
    """Reports 20 times per second, so that tests wait less for diagnostics."""

    @every(hz=20)
    def report(self) -> None:
        super().report()


class EmulatedDriver:
    """A driver and the emulated sensor that it reads."""

    def __init__(
        self,
        emulator: Emulator,
        device: Any,
        sent: list[SentScan],
        restarts: int = 0,
        **parameters: Any,
    ) -> None:
        self.emulator = emulator
        self.device = device
        self.sent = sent
        bus = LockstepBus()
        self.scans = Received(bus, "scan", LaserScan)
        self.multi = Received(bus, "multi_echo_scan", MultiEchoLaserScan)
        self.diagnostics = Received(bus, "diagnostics", DiagnosticArray)
        self.component = ThreadedComponent(
            FrequentReporter, bus, parameters=parameters, restarts=restarts
        )

    def health(self, accept: Callable[[Any], bool], after: int | None = None) -> Any:
        """Wait for diagnostics, by default new ones, that `accept` holds of; return the status."""
        start = len(self.diagnostics) if after is None else after
        messages = self.diagnostics.wait_for(
            lambda all_: any(accept(one.status[0]) for one in all_[start:])
        )
        return next(one.status[0] for one in messages[start:] if accept(one.status[0]))


@contextmanager
def emulated_driver(
    folder: Path,
    model: str = "UTM-30LX",
    *,
    tcp: bool = False,
    cable: tuple[LineEnd, str] | None = None,
    emulated: dict[str, Any] | None = None,
    line: dict[str, Any] | None = None,
    activate: bool = True,
    reply_timeout_s: float = LIMIT_S,
    **parameters: Any,
) -> Iterator[EmulatedDriver]:
    """Run the driver with a sensor of the model: on a pseudo-terminal, over TCP, or on a cable.

    A cable is the device's end of it, and the port that the driver opens. The driver awaits each
    reply for `reply_timeout_s`, and takes no silence for a fault unless the test sets `silence_s`:
    a busy computer must not make it connect again. A test whose sensor leaves commands unanswered
    needs `REPLY_TIMEOUT_S`, and `restarts=1`, with which a late reply does not fail configuration.
    """
    parameters = {"silence_s": _NEVER_S, **parameters}
    sent: list[SentScan] = []
    device = EmulatedScip(model, on_scan=sent.append, **(emulated or {}))
    end, port = cable or (PtyEnd(folder / "scanner"), str(folder / "scanner"))
    if tcp:
        end = TcpEnd(0)
    with pytest.MonkeyPatch.context() as patch, Emulator(device, end, **(line or {})) as emulator:
        patch.setattr("cairn.components.hokuyo_scanner.client._REPLY_TIMEOUT_S", reply_timeout_s)
        where: dict[str, Any] = {"port": port}
        if isinstance(end, TcpEnd):
            where = {"host": "127.0.0.1", "tcp_port": end.port}
        driver = EmulatedDriver(emulator, device, sent, **(where | parameters))
        try:
            if activate:
                driver.component.activate()
            yield driver
        finally:
            driver.component.close()


def assert_were_sent(
    scans: Sequence[Any],
    sent: Sequence[SentScan],
    model: str,
    *,
    echo: str = "first",
    short: bool = False,
) -> list[SentScan]:
    """Check that every scan equals, value by value, one that was sent, in this order; return these.

    A busy computer may drop some.
    """
    left = iter(sent)
    found = []
    for number, scan in enumerate(scans):
        for one in left:
            if _equal(scan, one, model, echo, short=short):
                found.append(one)
                break
        else:
            raise AssertionError(f"scan {number} was not sent, or not in this order")
    return found


def _equal(scan: Any, sent: SentScan, model: str, echo: str, *, short: bool) -> bool:
    rows = np.arange(len(sent.distances))
    column = np.zeros(len(rows), np.intp)
    if echo == "strongest" and sent.intensities is not None:
        column = np.argmax(sent.intensities, axis=1)
    expected = ranges(sent.distances[rows, column], model, short=short)
    if len(expected) != scan.ranges.size or not np.allclose(
        scan.ranges, expected, rtol=0, atol=1e-5, equal_nan=True
    ):
        return False
    if sent.intensities is None:
        return bool(scan.intensities.size == 0)
    return np.array_equal(scan.intensities, sent.intensities[rows, column])


def ranges(values: Any, model: str, *, short: bool = False) -> list[float]:
    """Return ranges [m] of REP 117 for values as they were sent [mm or code]."""
    least, most = _LIMITS[model[:3]]
    most = min(most, _SHORT_MOST) if short else most
    codes = {} if model.startswith("URG") else _CODES
    found = []
    for value in values.tolist():
        if value > most:
            found.append(math.inf)
        elif value < least:
            found.append(codes.get(value, math.nan))
        else:
            found.append(value / 1000)
    return found
