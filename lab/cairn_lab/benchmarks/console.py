"""The console: its cost, how fast a scan reaches a browser, and what slow browsers cost.

    python -m cairn_lab.benchmarks console

A process with a router publishes scans at 10 Hz and color images of 640 x 480 pixels at 5 Hz. The
console is `cairn console` in a process of its own. One browser subscribes to all of it, with images
as JPEG as the page does; then ten more, without JPEG, read 100 kB/s each.
"""

import itertools
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import psutil
from websockets.client import ClientProtocol
from websockets.sync.client import connect
from websockets.typing import Subprotocol
from websockets.uri import parse_uri

from cairn.bus.qos import SENSOR
from cairn.bus.session import open_router
from cairn.bus.zenoh_bus import ZenohBus
from cairn.console.protocol import CONSOLE
from cairn.schemas.sensor_msgs import Image, LaserScan
from cairn.testing.launching import CAIRN
from cairn_lab.benchmarks.result import Metric

SECONDS = 8.0
"""Length of each measurement."""
SLOW = 10
SLOW_RATE = 100_000  # bytes/s
SCANS = "/robot/scan"
IMAGES = "/robot/left/image"
_FIGURES = re.compile(r"console: http(\S+)/#(token=\S+)")


def publish(path: str) -> None:
    """Publish until SIGTERM; then print when each scan was published, and for how long [s]."""
    bus = ZenohBus(open_router(Path(path)))
    node = bus.node("/robot/sensors", print)
    scans = node.advertise(SCANS, LaserScan, SENSOR)
    images = node.advertise(IMAGES, Image, SENSOR)
    ranges = np.linspace(0.5, 5.0, 682, dtype=np.float32)
    scan = LaserScan(
        angle_min=-2.0, angle_max=2.0, angle_increment=4.0 / 682, range_max=5.5, ranges=ranges
    )
    rows, columns = np.mgrid[0:480, 0:640]
    pixels = np.stack([rows / 2, columns / 3, (rows ^ columns) & 255], axis=2).astype(np.uint8)
    image = Image(height=480, width=640, encoding="rgb8", step=1920, data=pixels.reshape(-1))
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    print("ready", flush=True)
    published: list[tuple[float, float]] = []
    start = time.monotonic()
    for tick in itertools.count():
        if ended.wait(max(0.0, start + tick / 10 - time.monotonic())):
            break
        began = time.monotonic()
        scans.publish(scan)
        if tick % 2 == 0:
            images.publish(image)
        published.append((began, time.monotonic() - began))
    bus.close()
    print(json.dumps(published), flush=True)


@contextmanager
def program(*command: str) -> "Iterator[subprocess.Popen[str]]":
    """Run a program whose output is read."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.terminate()


def first_line(process: "subprocess.Popen[str]") -> str:
    """Return the first line that a program prints."""
    assert process.stdout is not None
    return process.stdout.readline()


class FastBrowser(threading.Thread):
    """Subscribes to everything, and keeps the latencies of scans [s]."""

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self._socket = connect(url, subprotocols=[Subprotocol(CONSOLE)], max_size=None, legacy=True)
        self.latencies: list[float] = []
        self.images = 0
        self.start()

    def run(self) -> None:
        """Read until the connection is closed."""
        topics: dict[int, str] = {}
        for frame in self._socket:
            if isinstance(frame, str):
                message = json.loads(frame)
                for one in message["channels"] if message["op"] == "advertise" else ():
                    topics[one["id"]] = one["topic"]
                    wanted = {
                        "id": one["id"],
                        "channelId": one["id"],
                        "jpeg": one["topic"] == IMAGES,
                    }
                    self._socket.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
            elif topics[int.from_bytes(frame[1:5], "little")] == SCANS:
                sent_ns = int.from_bytes(frame[5:13], "little")
                self.latencies.append((time.time_ns() - sent_ns) / 1e9)
            else:
                self.images += 1

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


class SlowBrowser(threading.Thread):
    """Subscribes to everything, and reads 100 kB/s from its socket."""

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self._uri = parse_uri(url)
        self._ended = threading.Event()
        self.bytes = 0
        self.start()

    def run(self) -> None:
        """Read until `close`."""
        protocol = ClientProtocol(
            self._uri, subprotocols=[Subprotocol("foxglove.websocket.v1")], max_size=None
        )
        with socket.socket() as raw:
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 32 << 10)
            raw.connect((self._uri.host, self._uri.port))
            protocol.send_request(protocol.connect())
            while not self._ended.wait(0.1):
                for data in protocol.data_to_send():
                    raw.sendall(data)
                data = raw.recv(SLOW_RATE // 10)
                self.bytes += len(data)
                protocol.receive_data(data)
                for event in protocol.events_received():
                    text = getattr(event, "data", b"")
                    if text[:1] == b"{" and (message := json.loads(text))["op"] == "advertise":
                        wanted = [{"id": one["id"], "channelId": one["id"]}
                                  for one in message["channels"]]  # fmt: skip
                        subscribe = {"op": "subscribe", "subscriptions": wanted}
                        protocol.send_text(json.dumps(subscribe).encode())

    def close(self) -> None:
        """End, without a farewell."""
        self._ended.set()


def measure(seconds: float = SECONDS) -> list[Metric]:
    """Measure, for so long each time [s], without a console, with one browser, with slow ones."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="cairn-")))
        path = str(folder / "router.sock")
        robot = stack.enter_context(
            program(sys.executable, "-m", "cairn_lab.benchmarks.console", "--publish", path)
        )
        assert first_line(robot) == "ready\n"
        alone = _load(robot.pid, seconds)
        console = stack.enter_context(program(CAIRN, "console", "--port", "0", "--connect", path))
        found = _FIGURES.match(first_line(console))
        assert found is not None
        url = f"ws{found[1]}/ws?{found[2]}"
        fast = FastBrowser(url)
        _await(lambda: len(fast.latencies) > 10)
        fast.latencies.clear()
        memory = psutil.Process(console.pid).memory_info().rss
        start = time.monotonic()
        open_, gateway = _loads((robot.pid, console.pid), seconds)
        latencies, images = list(fast.latencies), fast.images
        slow = [SlowBrowser(url) for _ in range(SLOW)]
        _await(lambda: all(one.bytes for one in slow))
        fast.latencies.clear()
        crowded_start = time.monotonic()
        _, crowded = _loads((robot.pid, console.pid), seconds)
        grown = psutil.Process(console.pid).memory_info().rss - memory
        crowded_latencies = list(fast.latencies)
        read = sum(one.bytes for one in slow)
        fast.close()
        for one in slow:
            one.close()
        robot.terminate()
        assert robot.stdout is not None
        published = json.loads(robot.stdout.read())
    calm = [took for at, took in published if start < at < start + seconds]
    pressed = [took for at, took in published if at > crowded_start]
    core = "of a core"
    return [
        Metric("console, one browser", 100 * gateway, "%", 15,
               note=f"{core}, {len(latencies)} scans and {images} images"),
        Metric("robot, more by an open console", 100 * (open_ - alone), "%", 3,
               note=f"{core}; {100 * alone:.1f} % without"),
        Metric("scan to browser", 1e3 * median(latencies), "ms", 100,
               note=f"median; longest {1e3 * max(latencies):.0f} ms"),
        Metric("the same beside slow browsers", 1e3 * median(crowded_latencies), "ms", 100,
               note=f"{len(crowded_latencies) / seconds:.1f} scans/s; {SLOW} slow browsers"),
        Metric("console with slow browsers", 100 * crowded, "%",
               note=f"{core}; they have read {read / 1e6:.1f} MB"),
        Metric("memory for slow browsers", grown / 2**20, "MiB", 100),
        Metric("publication beside slow browsers", 1e3 * median(pressed), "ms",
               2e3 * median(calm) + 1, note=f"median; longest {1e3 * max(pressed):.0f} ms; "
               f"without them {1e3 * median(calm):.2f} and {1e3 * max(calm):.0f} ms"),
    ]  # fmt: skip


def _load(pid: int, seconds: float) -> float:
    return _loads((pid,), seconds)[0]


def _loads(pids: tuple[int, ...], seconds: float) -> list[float]:
    """Return the processor time that each process takes for a while, as a part of a core."""
    before = [_cpu_s(pid) for pid in pids]
    start = time.monotonic()
    time.sleep(seconds)
    elapsed = time.monotonic() - start
    return [(_cpu_s(pid) - was) / elapsed for pid, was in zip(pids, before, strict=True)]


def _cpu_s(pid: int) -> float:
    times = psutil.Process(pid).cpu_times()
    return times.user + times.system


def _await(holds: Any, limit_s: float = 60.0) -> None:
    deadline = time.monotonic() + limit_s
    while not holds():
        assert time.monotonic() < deadline, "the console does not deliver"
        time.sleep(0.05)


if __name__ == "__main__":
    publish(sys.argv[2])
