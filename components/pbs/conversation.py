"""Talks with a PBS-03JN over a serial line, on a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.pbs.config import PbsConfig
from cairn.components.pbs.frames import FrameSplitter
from cairn.components.pbs.messages import BAUD
from cairn.components.pbs.scan_message import TURN_S
from cairn.components.pbs.session import Session
from cairn.driver.errors import DeviceError
from cairn.driver.link import SerialLink

_REFUSALS = 4  # of the link, in a row
_LISTEN_S = 0.1
_CONNECT_S = 3.0


@dataclass(frozen=True)
class Measured:
    """Distances [mm] of all rays, and about when their turn began [s, monotonic clock]."""

    distances: NDArray[np.int32]
    began: float


class Conversation:
    """Connects the sensor, holds the link, asks for distances. Others may read the attributes."""

    def __init__(self, config: PbsConfig, on_scan: Callable[[Measured], None]) -> None:
        self.scans = 0
        self.damaged = 0
        """Damaged frames so far."""
        self.missed = 0
        """Requests that were not answered so far."""
        self.connections = 0
        self._config = config
        self._on_scan = on_scan

    def probe(self) -> None:
        """Link with the sensor and let go of it; raises `DeviceError` if it is not there."""
        found = threading.Event()
        deadline = time.monotonic() + _CONNECT_S
        self._talk(lambda: found.is_set() or time.monotonic() > deadline, found.set)
        if not found.is_set():
            raise self._silence()

    def converse(self, stopping: threading.Event, well: Callable[[str], None]) -> None:
        """Measure until told to stop; `well` is told once there are distances."""
        told = threading.Event()

        def linked() -> None:
            if not told.is_set():
                told.set()
                self.connections += 1
                well(f"{self._config.port}: the PBS-03JN is linked")

        self._talk(stopping.is_set, linked)

    def _talk(self, over: Callable[[], bool], linked: Callable[[], None]) -> None:
        link = SerialLink(self._config.port, BAUD, data_bits=self._config.data_bits)
        session = Session(1.0 / self._config.rate)
        splitter = FrameSplitter()
        damaged, missed = self.damaged, self.missed
        try:
            link.discard()
            while not over():
                frame = session.step(time.monotonic())
                if frame is not None:
                    link.write(frame)
                wait_s = min(_LISTEN_S, max(0.0, session.due() - time.monotonic()))
                self._take(session, splitter.feed(link.read(wait_s)))
                self.damaged, self.missed = damaged + splitter.damaged, missed + session.missed
                if session.linked:
                    linked()
                if session.silent:
                    raise self._silence()
                if session.refusals >= _REFUSALS:
                    raise DeviceError(
                        f"{self._config.port}: the PBS-03JN refuses the link; does another program "
                        "use it, or is it another device?"
                    )
            farewell = session.farewell()
            if farewell is not None:
                link.write(farewell)
        finally:
            link.close()

    def _take(self, session: Session, payloads: list[bytes]) -> None:
        for payload in payloads:
            distances = session.heard(payload, time.monotonic())
            if distances is not None:
                self.scans += 1
                # The sensor tells its last turn, which ended within a turn before it was asked.
                self._on_scan(Measured(distances, session.asked_at - 1.5 * TURN_S))

    def _silence(self) -> DeviceError:
        return DeviceError(
            f"{self._config.port}: no PBS-03JN answers; is it powered (24 V), and are its lines "
            "crossed as they should be?"
        )
