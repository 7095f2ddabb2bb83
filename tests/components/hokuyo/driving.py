"""The driver on a thread of its own, at one end of a line; an emulated sensor at the other."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cairn import RELIABLE
from cairn.bus.lockstep_bus import LockstepBus
from cairn.components.hokuyo.component import HokuyoScanner
from cairn.components.hokuyo.emulated_record import SentScan
from cairn.components.hokuyo.emulated_scip import EmulatedScip
from cairn.driver.emulator import Emulator
from cairn.driver.emulator_lines import LineEnd, PtyEnd, TcpEnd
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan, MultiEchoLaserScan
from tests.cairn.runtime.running import Threaded
from tests.patience import LIMIT_S

_ALL = RELIABLE.with_depth(1_000_000)


class Heard:
    """All messages of one topic, as they come."""

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
        """Those so far."""
        with self._changed:
            return list(self._messages)

    def wait(self, number: int, after: int = 0) -> list[Any]:
        """The next so many after the first `after` ones, once they are there."""
        return self.wait_for(lambda messages: len(messages) >= after + number)[
            after : after + number
        ]

    def wait_for(self, enough: Callable[[list[Any]], bool], limit_s: float = LIMIT_S) -> list[Any]:
        """All so far, once that holds."""
        deadline = time.monotonic() + limit_s
        with self._changed:
            while not enough(self._messages):
                left_s = deadline - time.monotonic()
                assert left_s > 0, f"after {limit_s:g} s only {len(self._messages)} have come"
                self._changed.wait(left_s)
            return list(self._messages)


class Driven:
    """A driver and its emulated sensor."""

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
        self.scans = Heard(bus, "scan", LaserScan)
        self.multi = Heard(bus, "multi_echo_scan", MultiEchoLaserScan)
        self.diagnostics = Heard(bus, "diagnostics", DiagnosticArray)
        self.component = Threaded(HokuyoScanner, bus, parameters=parameters, restarts=restarts)

    def health(self, accept: Callable[[Any], bool]) -> Any:
        """The first health told from now on that is as wanted."""
        before = len(self.diagnostics)
        told = self.diagnostics.wait_for(
            lambda all_: any(accept(one.status[0]) for one in all_[before:])
        )
        return next(one.status[0] for one in told[before:] if accept(one.status[0]))


@contextmanager
def driven(
    folder: Path,
    model: str = "UTM-30LX",
    *,
    tcp: bool = False,
    cable: tuple[LineEnd, str] | None = None,
    emulated: dict[str, Any] | None = None,
    line: dict[str, Any] | None = None,
    activate: bool = True,
    **parameters: Any,
) -> Iterator[Driven]:
    """A sensor of the model, driven: on a pseudo-terminal in the folder, by TCP, or on a cable.

    A cable is the device's end of it, and the port that the driver opens.
    """
    sent: list[SentScan] = []
    device = EmulatedScip(model, on_scan=sent.append, **(emulated or {}))
    end, port = cable or (PtyEnd(folder / "scanner"), str(folder / "scanner"))
    if tcp:
        end = TcpEnd(0)
    with Emulator(device, end, **(line or {})) as emulator:
        where: dict[str, Any] = {"port": port}
        if isinstance(end, TcpEnd):
            where = {"host": "127.0.0.1", "tcp_port": end.port}
        both = Driven(emulator, device, sent, **(where | parameters))
        try:
            if activate:
                both.component.activate()
            yield both
        finally:
            both.component.close()
