"""Round trip between two processes through ports, compared with raw zenoh-python.

Also that over Unix sockets, by which components are linked, compared with loopback TCP.
"""

import json
import multiprocessing
import statistics
import tempfile
import threading
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import zenoh
from pydantic import Field

from cairn import In, Out, on
from cairn.bus.codec import Codec
from cairn.runtime.component import Component
from cairn.runtime.parameters import Config
from cairn.schemas.sensor_msgs import Image, LaserScan
from cairn.schemas.std_msgs import Header, String
from cairn.testing.launching import free_port
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.running import results, run_deployment

ROUNDS = 5
LIMIT = 1.5
_SLOWER = 1.1  # more than the scatter between rounds
PAYLOADS = {"64 B": 2000, "2.8 kB scan": 2000, "300 kB image": 400}
_HERE = "cairn_lab.benchmarks.roundtrip"


def payload(name: str) -> Any:
    """Return the message of a payload."""
    header = Header(frame_id="bench")
    match name:
        case "64 B":
            return String(data="x" * 55)
        case "2.8 kB scan":
            return LaserScan(
                header=header,
                angle_max=6.81,
                angle_increment=0.01,
                range_max=30.0,
                ranges=np.linspace(1, 20, 682, dtype=np.float32),
            )
        case _:
            pixels = np.zeros(640 * 480, np.uint8)
            return Image(header=header, height=480, width=640, encoding="mono8", step=640,
                         data=pixels)  # fmt: skip


class PingConfig(Config):
    """Parameters of a ping."""

    payload: str = Field(description="Name of the payload.")
    count: int = Field(ge=1, description="Round trips [1].")


class Ping(Component):
    """Publishes messages and measures the round trip to its handler."""

    config: PingConfig

    def on_activate(self) -> None:
        """Publish the first message."""
        self._message = payload(self.config.payload)
        self._times: list[float] = []
        self.schedule(self.clock.now(), self._send)

    def _send(self) -> None:
        self._sent = time.perf_counter()
        self.ping.publish(self._message)  # type: ignore[attr-defined]

    def came_back(self) -> None:
        """Record the round trip and publish the next message."""
        self._times.append(time.perf_counter() - self._sent)
        if len(self._times) < self.config.count:
            self._send()
        else:
            tenth = len(self._times) // 10
            self.log.info("RESULT %s", json.dumps(summary(self._times[tenth:])))
            self.finish("measured")


class TextPing(Ping):
    """Publishes 64 bytes."""

    ping: Out[String]
    pong: In[String]

    @on("pong")
    def back(self, _: String) -> None:
        """Receive the answer."""
        self.came_back()


class ScanPing(Ping):
    """Publishes scans of 2.8 kB."""

    ping: Out[LaserScan]
    pong: In[LaserScan]

    @on("pong")
    def back(self, _: LaserScan) -> None:
        """Receive the answer."""
        self.came_back()


class ImagePing(Ping):
    """Publishes images of 300 kB."""

    ping: Out[Image]
    pong: In[Image]

    @on("pong")
    def back(self, _: Image) -> None:
        """Receive the answer."""
        self.came_back()


class TextPong(Component):
    """Publishes 64 bytes again."""

    ping: In[String]
    pong: Out[String]

    @on("ping")
    def answer(self, message: String) -> None:
        """Publish the message again."""
        self.pong.publish(message)


class ScanPong(Component):
    """Publishes a scan again."""

    ping: In[LaserScan]
    pong: Out[LaserScan]

    @on("ping")
    def answer(self, message: LaserScan) -> None:
        """Publish the message again."""
        self.pong.publish(message)


class ImagePong(Component):
    """Publishes an image again."""

    ping: In[Image]
    pong: Out[Image]

    @on("ping")
    def answer(self, message: Image) -> None:
        """Publish the message again."""
        self.pong.publish(message)


_CLASSES = {"64 B": "Text", "2.8 kB scan": "Scan", "300 kB image": "Image"}


def through_ports(name: str) -> dict[str, float]:
    """Return median and 99th percentile [us] of the round trip through two components' ports."""
    kind = _CLASSES[name]
    output = run_deployment(
        {
            "pong": {"plugin": f"{_HERE}:{kind}Pong"},
            "ping": {
                "plugin": f"{_HERE}:{kind}Ping",
                "parameters": {"payload": name, "count": PAYLOADS[name]},
                "restart": "transient",
                "significant": True,
            },
        },
        120,
    )
    return {key: float(value) for key, value in results(output)[0].items()}


def raw(name: str, handler: str, endpoint: str) -> dict[str, float]:
    """Return the same for zenoh-python alone; `handler` is "ring" or "callback"."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_raw_pong, args=(endpoint, handler, theirs))
    process.start()
    try:
        if not ours.poll(30) or ours.recv() != "ready":
            raise RuntimeError("the other process did not start")
        return _raw_ping(endpoint, handler, Codec().encode(payload(name)), PAYLOADS[name])
    finally:
        ours.send("end")
        process.join(10)
        process.kill()


def _raw_ping(endpoint: str, handler: str, data: bytes, count: int) -> dict[str, float]:
    with raw_session(connect=endpoint) as session:
        publisher = session.declare_publisher("bench/ping", express=False)
        back = threading.Semaphore(0)
        subscriber: Any
        if handler == "callback":

            def returned(sample: zenoh.Sample) -> None:
                sample.payload.to_bytes()
                back.release()

            subscriber = session.declare_subscriber("bench/pong", returned)
        else:
            subscriber = session.declare_subscriber("bench/pong", zenoh.handlers.RingChannel(10))
        matched: Any = publisher.matching_status
        while not matched.matching:
            matched = publisher.matching_status
        times = []
        for _ in range(count):
            begin = time.perf_counter()
            publisher.put(data)
            if handler == "callback":
                if not back.acquire(timeout=5):
                    raise RuntimeError("a message did not come back")
            else:
                subscriber.recv().payload.to_bytes()
            times.append(time.perf_counter() - begin)
        subscriber.undeclare()
    return summary(times[count // 10 :])


def _raw_pong(endpoint: str, handler: str, parent: Connection) -> None:
    with raw_session(listen=endpoint) as session:
        publisher = session.declare_publisher("bench/pong", express=False)

        def answer(sample: zenoh.Sample) -> None:
            publisher.put(sample.payload.to_bytes())

        subscriber: Any
        drainer: threading.Thread | None = None
        if handler == "callback":
            subscriber = session.declare_subscriber("bench/ping", answer)
        else:
            ring: Any = zenoh.handlers.RingChannel(10)
            subscriber = session.declare_subscriber("bench/ping", ring)
            channel = subscriber.handler

            def drain() -> None:
                while True:
                    try:
                        answer(channel.recv())
                    except zenoh.ZError:
                        return

            drainer = threading.Thread(target=drain)
            drainer.start()
        parent.send("ready")
        parent.poll(60)
        subscriber.undeclare()
        if drainer is not None:
            drainer.join()  # one that wakes in Zenoh while the interpreter ends aborts the process


def raw_session(*, listen: str | None = None, connect: str | None = None) -> zenoh.Session:
    """Return a session of zenoh-python alone, a peer that scouts for no others."""
    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "peer",
        "listen/endpoints": [listen] if listen else [],
        "connect/endpoints": [connect] if connect else [],
        "scouting/multicast/enabled": False,
        "transport/shared_memory/enabled": False,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def summary(seconds: list[float]) -> dict[str, float]:
    """Return median and 99th percentile in us."""
    ordered = sorted(seconds)
    return {
        "median": statistics.median(ordered) * 1e6,
        "p99": ordered[int(0.99 * (len(ordered) - 1))] * 1e6,
    }


def measure() -> list[Metric]:
    """Measure the ratio of the medians to the faster handler of raw zenoh-python."""
    metrics = []
    for name in PAYLOADS:
        ours, tcp, local = [], _by_handler(), _by_handler()
        for _ in range(ROUNDS):
            for handler in tcp:
                endpoint = f"tcp/127.0.0.1:{free_port()}"
                tcp[handler].append(raw(name, handler, endpoint)["median"])
                with tempfile.TemporaryDirectory() as folder:
                    endpoint = f"unixsock-stream/{folder}/raw.sock"
                    local[handler].append(raw(name, handler, endpoint)["median"])
            ours.append(through_ports(name)["median"])
        mine, by_tcp, by_socket = statistics.median(ours), _best(tcp), _best(local)
        handlers = (f"{handler} {statistics.median(found):.0f}" for handler, found in tcp.items())
        metrics += [
            Metric(
                f"round trip {name}: ports / raw zenoh over loopback TCP",
                mine / by_tcp,
                "x",
                at_most=LIMIT,
                note=f"{mine:.0f} us / {by_tcp:.0f} us (raw: {', '.join(handlers)})",
            ),
            Metric(
                f"round trip {name}: raw zenoh over a Unix socket / loopback TCP",
                by_socket / by_tcp,
                "x",
                at_most=_SLOWER,
                note=f"{by_socket:.0f} us / {by_tcp:.0f} us",
            ),
        ]
    return metrics


def _by_handler() -> dict[str, list[float]]:
    return {"ring": [], "callback": []}


def _best(medians: Mapping[str, list[float]]) -> float:
    return min(statistics.median(found) for found in medians.values())
