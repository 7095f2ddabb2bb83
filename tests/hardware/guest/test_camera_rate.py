"""Two cameras of 640 x 480 pixels at 25 pictures a second, without one lost."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from types import TracebackType
from typing import Self

import pytest

from tests.components.v4l2_camera.driving import Driver
from tests.hardware.guest.camera import LEFT, RIGHT, load_cameras, unload

_WINDOWS, _PICTURES = 4, 75
_PERIOD_MS = 40.0
_SATURATED = 0.9  # of a processor: one interpreter cannot do more
_NAP = """
import time
late = 0.0
while True:
    due = time.monotonic() + 0.01
    time.sleep(0.01)
    late = max(late, time.monotonic() - due)
    print(f"{1e3 * late:.1f}", flush=True)
"""


class Naps:
    """A process that naps for 10 ms again and again; by how much it oversleeps tells how the host
    treats the guest: the guest's own scheduler wakes who naps at once, however busy others are."""

    def __enter__(self) -> Self:
        """Begin."""
        command = [sys.executable, "-S", "-c", _NAP]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End, and take the longest [ms]."""
        self._process.kill()
        told, _ = self._process.communicate()
        self.longest_ms = max(map(float, told.splitlines()[:-1]), default=0.0)


@pytest.fixture(scope="module", autouse=True)
def _cameras() -> Iterator[None]:
    load_cameras()
    yield
    unload("vivid")


@pytest.mark.parametrize("pixel_format", ["GREY", "YUYV"])
def test_no_picture_is_lost(pixel_format: str) -> None:
    spoiled, pauses, shares = [], [], []
    with Driver(device=LEFT, right_device=RIGHT, format=pixel_format, rate=25) as driver:
        driver.await_one("right_image")
        driver.await_pictures(25)
        for _ in range(_WINDOWS):
            before = losses(driver)
            begun, used = time.monotonic(), time.process_time()
            with Naps() as naps:
                driver.await_pictures(_PICTURES)
            after = losses(driver)
            if after == before:
                return
            spoiled.append([new - old for old, new in zip(before, after, strict=True)])
            pauses.append(naps.longest_ms)
            shares.append((time.process_time() - used) / (time.monotonic() - begun))

    told = f"lost and skipped, left and right, of {_PICTURES} pictures each: {spoiled}"
    if min(pauses) > _PERIOD_MS:
        pytest.skip(f"the host leaves the guest no time: it pauses for {pauses} ms; {told}")
    lost = any(left or right for left, _, right, _ in spoiled)
    if min(shares) > _SATURATED and not lost:
        # What the kernel delivers, and nobody has time for, gives way to what is newer.
        pytest.skip(f"the emulated processor is too slow, {min(shares):.2f} of it used; {told}")
    pytest.fail(told)


def losses(driver: Driver) -> list[int]:
    """Pictures lost and skipped so far, of the left and of the right camera."""
    told = [driver.values(index) for index in range(2)]
    return [int(one[name]) for one in told for name in ("lost", "skipped")]
