"""Processor time and delay of the SCIP driver: an emulated UTM-30LX at 40 Hz."""

from __future__ import annotations

import multiprocessing
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import zenoh

from cairn.bus.session import open_peer
from cairn.components.hokuyo_scanner.config import HokuyoConfig
from cairn.components.hokuyo_scanner.emulator import EmulatedScip
from cairn.components.hokuyo_scanner.sensor import Measurement, StampedScan
from cairn.driver.emulator import Emulator
from cairn.driver.emulator_lines import PtyEnd
from cairn.schemas.sensor_msgs import LaserScan
from cairn.testing.launching import launching
from cairn.testing.robot import RunningDeployment
from cairn_lab.benchmarks.result import Metric

_SCANS = 400
_PERIOD_S = 0.025
_BYTES = 4400  # of a scan on the bus
_LIMIT_S = 30.0


class _TimedEnd(PtyEnd):
    """A pseudo-terminal that records when it sent the last byte of each scan [ns since 1970]."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.scans: list[int] = []

    def write(self, data: bytes) -> int:
        sent = super().write(data)
        if sent == len(data) > 1000:
            self.scans.append(time.time_ns())
        return sent


def measure() -> list[Metric]:
    """Measure processor time of protocol and decoding, of the driver; delay to a reader."""
    with tempfile.TemporaryDirectory() as folder:
        alone = _protocol(Path(folder) / "scanner")
    with tempfile.TemporaryDirectory() as folder:
        driver, delays, hops = _driver(Path(folder))
    late = ", ".join(f"{share} %: {np.percentile(delays, share):.2f} ms" for share in (95, 99))
    bare = f"a bare Zenoh message of as many bytes takes {np.median(hops):.2f} ms, median"
    return [
        Metric("UTM-30LX, 40 Hz: protocol and decoding, of a core", alone, "%", 3.0),
        Metric("the same: the driver's process, two readers of scans", driver, "%"),
        Metric(
            "last byte of a scan to its reader in another process, median",
            float(np.median(delays)),
            "ms",
            2.0,
            note=f"{late}; {bare}",
        ),
    ]


def _protocol(port: Path) -> float:
    """Return the share of a core [%] of the thread that reads, checks and decodes scans."""
    used: list[float] = []
    stopping = threading.Event()
    count = 0
    started = 0.0

    def on_scan(_: StampedScan) -> None:
        nonlocal count, started
        count += 1
        if count == 1:
            started = time.monotonic()
            used.append(time.thread_time())
        if count == _SCANS:
            used.append(time.thread_time())
            used.append(time.monotonic() - started)
            stopping.set()

    with Emulator(EmulatedScip("UTM-30LX"), PtyEnd(port)):
        measurement = Measurement(HokuyoConfig(port=str(port)), on_scan)
        measurement.run(stopping, lambda _: None)
        measurement.disconnect()
    return 100.0 * (used[1] - used[0]) / used[2]


def _driver(folder: Path) -> tuple[float, list[float], list[float]]:
    """Return the share of a core [%] of the driver's process, and delays [ms] to a reader.

    The delays are those of scans, from their last byte on, and of bare messages.
    """
    port = folder / "scanner"
    end = _TimedEnd(port)
    deployment = f"""
        components:
          scanner: {{plugin: hokuyo_scanner, parameters: {{port: {port}}}}}
        """
    with Emulator(EmulatedScip("UTM-30LX"), end), launching(folder) as launch:
        run = launch(deployment)
        robot = RunningDeployment(run)
        try:
            scans = robot.read("scan", LaserScan, lambda scan: LaserScan(header=scan.header))
            scans.await_count(40)
            process = psutil.Process(run.pid_of("scanner"))
            before, at = process.cpu_times(), time.monotonic()
            arrivals = scans.await_count(_SCANS, after=scans.count, limit_s=_LIMIT_S)
            after, took = process.cpu_times(), time.monotonic() - at
        finally:
            robot.close()
        hops = _hops(run.endpoint)
    used = after.user - before.user + after.system - before.system
    sent = np.array(end.scans)
    arrived = np.array([arrival.at_ns for arrival in arrivals])
    last = sent[np.searchsorted(sent, arrived) - 1]
    return 100.0 * used / took, ((arrived - last) / 1e6).tolist(), hops


def _hops(endpoint: str) -> list[float]:
    """Return delays [ms] of bare messages, as large and as frequent as scans."""
    delays: list[float] = []

    def record_delay(sample: zenoh.Sample) -> None:
        now = time.time_ns()
        delays.append((now - int(sample.payload.to_bytes().rstrip(b"-"))) / 1e6)

    session = open_peer((endpoint,))
    sender = multiprocessing.get_context("spawn").Process(target=_send_times, args=(endpoint,))
    try:
        session.declare_subscriber("bench/hop", record_delay)
        sender.start()
        sender.join(_LIMIT_S)
    finally:
        sender.kill()
        session.close()
    return delays[len(delays) // 10 :]  # the first ones wait for connections


def _send_times(endpoint: str) -> None:
    """Send messages that contain the time of sending [ns since 1970], in another process."""
    session = open_peer((endpoint,))
    publisher = session.declare_publisher("bench/hop")
    due = time.monotonic()
    for _ in range(_SCANS):
        due += _PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))
        publisher.put(str(time.time_ns()).encode().ljust(_BYTES, b"-"))
    session.close()
