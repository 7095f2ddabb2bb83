"""Health of cameras and pairs, for diagnostics: level, message, and the values behind them."""

from __future__ import annotations

from dataclasses import replace

from cairn.components.v4l2_camera.camera import VideoCamera
from cairn.components.v4l2_camera.frames import FrameCounts
from cairn.components.v4l2_camera.pairing import StereoPairer
from cairn.driver.diagnostics import ERROR, OK, WARN, diagnostics
from cairn.schemas.diagnostic_msgs import DiagnosticArray

_SLOW = 0.9  # share of the negotiated rate below which diagnostics warn
_OFTEN = 2.0  # [1/s]: slower cameras may have no image between two reports, one second apart


class CameraMonitor:
    """Reports the health of one camera by what has happened since the last report."""

    def __init__(self, name: str, camera: VideoCamera) -> None:
        self._name = name
        self._camera = camera
        self._before = replace(camera.counts)

    def report(self, now: int, device_error: str) -> DiagnosticArray:
        """Return its health at `now` [ns]; `device_error` is why it does not stream."""
        camera, counts = self._camera, replace(self._camera.counts)
        capture_format, rate = camera.capture_format, camera.rate()
        negotiated = 0.0 if capture_format is None else capture_format.rate
        level, message = judge(counts, self._before, rate, negotiated, device_error)
        self._before = counts
        layout = None if capture_format is None else capture_format.layout
        return diagnostics(
            now,
            self._name,
            camera.identity,
            level,
            message,
            {
                "format": layout or "not negotiated yet",
                "rate [1/s]": rate,
                "negotiated rate [1/s]": negotiated,
                "age when read [ms]": 1e3 * camera.latency_s,
                "stamped at": (
                    "start of exposure" if camera.stamps_at_start else "end of transfer"
                ),
                **vars(counts),
            },
        )


class PairMonitor:
    """Reports how images of two cameras pair, by what has happened since the last report."""

    def __init__(self, name: str, pairer: StereoPairer) -> None:
        self._name = name
        self._pairer = pairer
        self._pairs, self._unpaired = 0, 0

    def report(self, now: int) -> DiagnosticArray:
        """Return the health of the pair at `now` [ns]."""
        pairer = self._pairer
        pairs = pairer.pairs - self._pairs
        unpaired = sum(pairer.unpaired) - self._unpaired
        self._pairs, self._unpaired = pairer.pairs, sum(pairer.unpaired)
        offset_ms = 1e-6 * pairer.offset
        level, message = OK, f"right {offset_ms:+.2f} ms after left"
        if not pairs:
            level, message = ERROR, "no pairs"
        elif unpaired:
            level, message = WARN, f"{unpaired} unpaired images; {message}"
        left, right = pairer.unpaired
        values = {
            "pairs": pairer.pairs,
            "left unpaired": left,
            "right unpaired": right,
            "right after left [ms]": offset_ms,
            "tolerance [ms]": 1e-6 * pairer.tolerance,
        }
        return diagnostics(now, f"{self._name}: pairs", "", level, message, values)


def judge(
    counts: FrameCounts, before: FrameCounts, rate: float, nominal: float, device_error: str
) -> tuple[int, str]:
    """Return the level of a `DiagnosticStatus` and its message.

    Args:
        counts: the present counts.
        before: the counts of the last report.
        rate: of the images passed on [1/s].
        nominal: the negotiated rate [1/s], 0 if the camera does not report it.
        device_error: why it does not stream; empty if it does.
    """
    if device_error:
        return ERROR, device_error
    faults = counts.faults_since(before)
    details = f" ({', '.join(faults)})" if faults else ""
    is_slow = rate > 0.0 and 0.0 < nominal < _OFTEN  # it need not have sent one since
    if counts.images == before.images and not is_slow:
        return ERROR, f"no images arrive{details}"
    if rate < _SLOW * nominal:
        return WARN, f"{rate:.3g} images per second instead of {nominal:.3g}{details}"
    if faults:
        return WARN, f"images {', '.join(faults)}"
    return OK, f"{rate:.3g} images per second"
