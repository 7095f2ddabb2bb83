"""Latency of a fast topic beside a slow reader in the same process, and image traffic."""

import json
import time

import numpy as np

from cairn import In, Out, Supervisor, every, on
from cairn.bus.qos import RELIABLE, SENSOR
from cairn.runtime.component import Component
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.sensor_msgs import Image
from cairn.schemas.std_msgs import Header
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.running import results, run_deployment

_HERE = "cairn_lab.benchmarks.latency"
_SECONDS = 10
_FAST_HZ = 200
_BURN_S = 0.05


class Sender(Component):
    """Publishes small messages at a high rate; each contains its time of sending."""

    fast: Out[Twist]

    @every(hz=_FAST_HZ)
    def send(self) -> None:
        """Publish a message."""
        now = time.perf_counter()
        self.fast.publish(Twist(linear=Vector3(x=now)))


class ImageSource(Component):
    """Publishes 900 kB images at 30 Hz."""

    image: Out[Image] = Out(qos=SENSOR)

    def on_activate(self) -> None:
        """Create the image."""
        self._image = Image(
            header=Header(frame_id="camera"), height=480, width=640, encoding="rgb8", step=1920,
            data=np.zeros(480 * 1920, np.uint8),
        )  # fmt: skip

    @every(hz=30)
    def send(self) -> None:
        """Publish the image."""
        self.image.publish(self._image)


class BenchmarkSupervisor(Supervisor):
    """Hosts the reader and its slow neighbor in one process."""


class SlowReader(Component):
    """Reads images, and computes in Python for 50 ms over each."""

    image: In[Image] = In(qos=SENSOR)

    @on("image")
    def on_image(self, _: Image) -> None:
        """Keep the interpreter busy."""
        end = time.perf_counter() + _BURN_S
        while time.perf_counter() < end:
            pass


class FastReader(Component):
    """Measures the latency of the small messages."""

    fast: In[Twist] = In(qos=RELIABLE)

    def on_activate(self) -> None:
        """Start without measured times."""
        self._times: list[float] = []

    @on("fast")
    def read(self, message: Twist) -> None:
        """Record the latency; `perf_counter` is the same clock in all processes."""
        self._times.append(time.perf_counter() - message.linear.x)
        if len(self._times) == _SECONDS * _FAST_HZ:
            ordered = sorted(self._times)
            last = len(ordered) - 1
            result = {
                "median_ms": ordered[last // 2] * 1e3,
                "p99_ms": ordered[int(0.99 * last)] * 1e3,
                "max_ms": ordered[-1] * 1e3,
            }
            self.log.info("RESULT %s", json.dumps(result))
            self.finish("measured")


def measure() -> list[Metric]:
    """Measure the 99th percentile of the fast topic."""
    output = run_deployment(
        {
            "supervisor": {
                "plugin": f"{_HERE}:BenchmarkSupervisor",
                "children": {
                    "slow": {"plugin": f"{_HERE}:SlowReader", "placement": "in_process"},
                    "reader": {
                        "plugin": f"{_HERE}:FastReader",
                        "placement": "in_process",
                        "restart": "transient",
                        "significant": True,
                    },
                },
            },
            "camera": {"plugin": f"{_HERE}:ImageSource"},
            "sender": {"plugin": f"{_HERE}:Sender"},
        },
        120,
    )
    found = results(output)[0]
    note = f"median {found['median_ms']:.2f} ms, longest {found['max_ms']:.1f} ms"
    return [Metric("fast topic beside a slow neighbor: p99", found["p99_ms"], "ms", 5.0, note=note)]
