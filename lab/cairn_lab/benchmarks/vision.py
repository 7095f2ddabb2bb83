"""All processes in real time with a stereo camera: processor time, latency, dropped messages."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

from cairn import In, on
from cairn.bus.qos import RELIABLE
from cairn.runtime.component import Component
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.cairn_msgs import RecognizedObjectArray
from cairn.system.clock import SECOND
from cairn_lab.benchmarks.lockstep import ROOT
from cairn_lab.benchmarks.navigation import in_real_time
from cairn_lab.benchmarks.result import Metric

_PIXELS = ROOT / "deploy" / "pixels.yaml"
_WORLD = ROOT / "deploy" / "worlds" / "room.yaml"
_PERIOD_MS = 200.0
# Inputs that keep only the newest image: others that arrive during recognition are skipped.
_NEWEST_ONLY = ("object_recognizer.left_image", "object_recognizer.right_image")


class ObservationWatch(Component):
    """Measures the time from an exposure to the observations in it."""

    recognized_objects: In[RecognizedObjectArray] = In(qos=RELIABLE.with_depth(200))

    def on_activate(self) -> None:
        """Start without measured times."""
        self._times_ms: list[float] = []
        self._stamps: list[int] = []
        self._seen = 0

    @on("recognized_objects")
    def on_recognized_objects(self, frame: RecognizedObjectArray) -> None:
        """Record the delay of the observations of one image."""
        self._times_ms.append((self.clock.now() - to_ns(frame.header.stamp)) / (SECOND / 1000))
        self._stamps.append(to_ns(frame.header.stamp))
        self._seen += len(frame.objects)

    def on_deactivate(self) -> None:
        """Log the result."""
        ordered = sorted(self._times_ms)
        last = len(ordered) - 1
        taken = 1 + round((self._stamps[-1] - self._stamps[0]) / (SECOND / 1000) / _PERIOD_MS)
        self.log.info(
            "OBSERVATIONS %s",
            json.dumps(
                {
                    "median_ms": ordered[last // 2],
                    "p95_ms": ordered[int(0.95 * last)],
                    "most_ms": ordered[last],
                    "images": len(ordered),
                    "taken": taken,
                    "objects": self._seen,
                }
            ),
        )


def measure() -> list[Metric]:
    """Measure the tour of the room in real processes, from pixels."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        visual_map = folder / "room.cairn"
        subprocess.run(
            [
                sys.executable,
                "-m",
                "cairn.cli.program",
                "map",
                "import",
                "world",
                _WORLD,
                visual_map,
            ],
            check=True,
            capture_output=True,
            timeout=60,
        )
        watch = folder / "watch.yaml"
        watch.write_text(
            yaml.safe_dump({"components": {"watch": {"plugin": f"{__name__}:ObservationWatch"}}})
        )
        busy, latency = in_real_time(
            folder,
            *("--overlay", str(_PIXELS), "--overlay", str(watch)),
            *("--set", f"visual_map={visual_map}"),
        )
        report = json.loads((folder / "real" / "report.json").read_text())
        log = next((folder / "real" / "logs").glob("watch*")).read_text()
    seen = json.loads(log.partition("OBSERVATIONS ")[2].splitlines()[0])
    dropped = {
        port: count
        for port, count in report["dropped"].items()
        if count and port not in _NEWEST_ONLY
    }
    left_out = seen["taken"] - seen["images"]
    return [
        Metric(
            "all processes at 5 pairs of 640 x 480 and 10 scans a second: of two cores",
            100.0 * busy / 2.0,
            "%",
            at_most=100,
        ),
        Metric(
            "last beam of a scan to velocity command: p95",
            latency["p95_ms"],
            "ms",
            at_most=50,
            note=f"median {latency['median_ms']:.1f} ms of {latency['count']}",
        ),
        Metric(
            "exposure to observations: p95",
            seen["p95_ms"],
            "ms",
            at_most=_PERIOD_MS,
            note=f"median {seen['median_ms']:.0f} ms, {seen['images']} images, "
            f"{seen['objects']} objects",
        ),
        Metric(
            "images skipped because a newer one had arrived",
            100.0 * left_out / seen["taken"],
            "%",
            at_most=1,
            note=f"{left_out} of {seen['taken']}, start included",
        ),
        Metric(
            "messages dropped elsewhere",
            sum(dropped.values()),
            "",
            at_most=0,
            note=", ".join(dropped),
        ),
    ]
