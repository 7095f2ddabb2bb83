"""A PBS-03JN on a serial line, and the loop that has it measure, on a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.pbs_scanner.config import PbsConfig
from cairn.components.pbs_scanner.messages import TURN_S
from cairn.components.pbs_scanner.protocol import BAUD, FrameSplitter, PbsClient
from cairn.driver.errors import DeviceError
from cairn.driver.serial_and_tcp import SerialLink

_REFUSALS = 4  # of the link, in a row
_POLL_S = 0.1
_CONNECT_TIMEOUT_S = 3.0


@dataclass(frozen=True)
class TimedDistances:
    """Distances [mm] of all rays, and about when their turn began [s, monotonic clock]."""

    distances: NDArray[np.int32]
    began: float


class PbsMeasurement:
    """Connects the sensor, holds the link, requests distances.

    `run` is for a `DeviceThread`. Other threads may read the attributes.
    """

    def __init__(self, config: PbsConfig, on_scan: Callable[[TimedDistances], None]) -> None:
        self.scans = 0
        self.damaged = 0
        """Damaged frames so far."""
        self.missed = 0
        """Requests without a reply so far."""
        self.connections = 0
        self._config = config
        self._on_scan = on_scan

    def probe(self) -> None:
        """Obtain the link and end it; raises `DeviceError` if no sensor is there."""
        found = threading.Event()
        deadline = time.monotonic() + _CONNECT_TIMEOUT_S
        self._measure(lambda: found.is_set() or time.monotonic() > deadline, found.set)
        if not found.is_set():
            raise self._silence()

    def run(self, stopping: threading.Event, report_working: Callable[[str], None]) -> None:
        """Measure until `stopping`; raises `DeviceError` if the sensor fails."""
        reported = threading.Event()

        def on_link() -> None:
            if not reported.is_set():
                reported.set()
                self.connections += 1
                report_working(f"{self._config.port}: the PBS-03JN is linked")

        self._measure(stopping.is_set, on_link)

    def _measure(self, is_over: Callable[[], bool], on_link: Callable[[], None]) -> None:
        link = SerialLink(self._config.port, BAUD, data_bits=self._config.data_bits)
        client = PbsClient(1.0 / self._config.rate)
        splitter = FrameSplitter()
        damaged, missed = self.damaged, self.missed
        try:
            link.discard()
            while not is_over():
                frame = client.step(time.monotonic())
                if frame is not None:
                    link.write(frame)
                wait_s = min(_POLL_S, max(0.0, client.due() - time.monotonic()))
                self._receive(client, splitter.feed(link.read(wait_s)))
                self.damaged, self.missed = damaged + splitter.damaged, missed + client.missed
                if client.linked:
                    on_link()
                if client.silent:
                    raise self._silence()
                if client.refusals >= _REFUSALS:
                    raise DeviceError(
                        f"{self._config.port}: the PBS-03JN refuses the link; check that no other "
                        "program uses it, and that it is not another device"
                    )
            last = client.unlink()
            if last is not None:
                link.write(last)
        finally:
            link.close()

    def _receive(self, client: PbsClient, payloads: list[bytes]) -> None:
        for payload in payloads:
            distances = client.receive(payload, time.monotonic())
            if distances is not None:
                self.scans += 1
                # The sensor sends its last turn, which ended within a turn before the request.
                self._on_scan(TimedDistances(distances, client.requested_at - 1.5 * TURN_S))

    def _silence(self) -> DeviceError:
        return DeviceError(
            f"{self._config.port}: no PBS-03JN replies; check its power (24 V), and that its lines "
            "are crossed"
        )
