"""Cameras tried for some seconds: what comes of them, how fast, how old, and how well it pairs."""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial

from cairn import SECOND
from cairn.components.v4l2_camera.camera import Camera, CameraSettings
from cairn.components.v4l2_camera.device import Setup
from cairn.components.v4l2_camera.pairing import Pairing, Picture
from cairn.driver.device_thread import DeviceThread
from cairn.driver.errors import DeviceError


@dataclass
class Tried:
    """What came of one camera: its counts, ages [s] of its pictures, the newest one, troubles."""

    camera: Camera
    setup: Setup
    rate: float = 0.0
    ages: list[float] = field(default_factory=list)
    newest: Picture | None = None
    troubles: list[str] = field(default_factory=list)

    def as_lines(self, name: str) -> list[str]:
        """That in words."""
        counts = vars(self.camera.counts)
        lines = [
            f"{name}: {self.camera.identity}",
            f"  {self.setup.layout}, {self.rate:.4g} pictures a second; the camera agreed to "
            f"{self.setup.rate:.4g}",
            "  " + ", ".join(f"{number} {what}" for what, number in counts.items()),
        ]
        if self.ages:
            stamped = "exposure began" if self.camera.stamps_begin else "transfer ended"
            mean = sum(self.ages) / len(self.ages)
            lines.append(
                f"  stamped when the {stamped}; read {1e3 * mean:.3g} ms after that, at most "
                f"{1e3 * max(self.ages):.3g}"
            )
        return [*lines, *(f"  {trouble}" for trouble in self.troubles)]


@dataclass(frozen=True)
class Apart:
    """How two cameras pair: how many pairs, how far apart they were taken [s], what was left."""

    pairs: int
    apart: list[float]
    unpaired: int

    def as_lines(self) -> list[str]:
        """That in words."""
        if not self.apart:
            return [f"no pairs; {self.unpaired} pictures without their other"]
        mean = sum(self.apart) / len(self.apart)
        return [
            f"{self.pairs} pairs, {self.unpaired} pictures without their other; right "
            f"{1e3 * mean:+.2f} ms after left, from {1e3 * min(self.apart):+.2f} to "
            f"{1e3 * max(self.apart):+.2f}"
        ]


def tried(cameras: Sequence[CameraSettings], seconds: float) -> tuple[list[Tried], Apart]:
    """Read one camera or two for so long; raises `DeviceError` for one that cannot be opened."""
    came: queue.SimpleQueue[tuple[int, Picture]] = queue.SimpleQueue()
    log = logging.getLogger(__name__)
    with ExitStack() as stack:
        outcomes = []
        for side, settings in enumerate(cameras):
            camera = Camera(settings, {}, _accept_any, partial(_put, came, side), log)
            stack.callback(camera.close)
            outcomes.append(Tried(camera, camera.open()))
        for side, outcome in enumerate(outcomes):
            thread = DeviceThread(
                f"camera {side}",
                outcome.camera.converse,
                log=log,
                on_device_error=partial(_note, outcome),
                on_failure=partial(_note, outcome),
            )
            thread.start()
            stack.callback(thread.stop)
        return outcomes, _watched(came, outcomes, seconds)


def _accept_any(_: Setup) -> None:
    """What a camera gives is told."""


def _put(came: queue.SimpleQueue[tuple[int, Picture]], side: int, picture: Picture) -> None:
    came.put((side, picture))


def _watched(
    came: queue.SimpleQueue[tuple[int, Picture]], outcomes: Sequence[Tried], seconds: float
) -> Apart:
    slowest = min(outcome.setup.rate or 25.0 for outcome in outcomes)
    pairing, apart = Pairing(round(0.5 * SECOND / slowest)), []
    until = time.monotonic() + seconds
    while (left_s := until - time.monotonic()) > 0:
        try:
            side, picture = came.get(timeout=left_s)
        except queue.Empty:
            break
        outcome = outcomes[side]
        outcome.newest = picture
        outcome.ages.append(outcome.camera.latency_s)
        if pairing.add(side, picture) is not None:
            apart.append(1e-9 * pairing.apart)
    for outcome in outcomes:
        outcome.rate = outcome.camera.rate()
    return Apart(pairing.pairs, apart, sum(pairing.unpaired))


def _note(outcome: Tried, error: Exception) -> None:
    if str(error) not in outcome.troubles:
        outcome.troubles.append(str(error) if isinstance(error, DeviceError) else repr(error))
