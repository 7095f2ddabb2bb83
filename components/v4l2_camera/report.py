"""What is told of the cameras on topic `diagnostics`."""

from __future__ import annotations

from dataclasses import replace

from cairn.components.v4l2_camera.camera import Camera
from cairn.components.v4l2_camera.counts import health
from cairn.components.v4l2_camera.pairing import Pairing
from cairn.driver.diagnostics import ERROR, OK, WARN, diagnostics
from cairn.schemas.diagnostic_msgs import DiagnosticArray


class CameraReport:
    """Tells how one camera is, by what has happened since it was last told."""

    def __init__(self, name: str, camera: Camera) -> None:
        self._name = name
        self._camera = camera
        self._before = replace(camera.counts)

    def told(self, now: int, trouble: str) -> DiagnosticArray:
        """How it is at `now` [ns]; `trouble` says why it does not stream."""
        camera, counts = self._camera, replace(self._camera.counts)
        setup, rate = camera.setup, camera.rate()
        agreed = 0.0 if setup is None else setup.rate
        level, message = health(counts, self._before, rate, agreed, trouble)
        self._before = counts
        layout = None if setup is None else setup.layout
        return diagnostics(
            now,
            self._name,
            camera.identity,
            level,
            message,
            {
                "format": layout or "not agreed on yet",
                "rate [1/s]": rate,
                "rate agreed on [1/s]": agreed,
                "age when read [ms]": 1e3 * camera.latency_s,
                "stamped at": "begin of exposure" if camera.stamps_begin else "end of transfer",
                **vars(counts),
            },
        )


class PairReport:
    """Tells how two cameras make pairs, by what has happened since it was last told."""

    def __init__(self, name: str, pairing: Pairing) -> None:
        self._name = name
        self._pairing = pairing
        self._pairs, self._unpaired = 0, 0

    def told(self, now: int) -> DiagnosticArray:
        """How it is at `now` [ns]."""
        pairing = self._pairing
        pairs = pairing.pairs - self._pairs
        unpaired = sum(pairing.unpaired) - self._unpaired
        self._pairs, self._unpaired = pairing.pairs, sum(pairing.unpaired)
        apart_ms = 1e-6 * pairing.apart
        level, message = OK, f"right {apart_ms:+.2f} ms after left"
        if not pairs:
            level, message = ERROR, "no pairs"
        elif unpaired:
            level, message = WARN, f"{unpaired} pictures without their other; {message}"
        left, right = pairing.unpaired
        values = {
            "pairs": pairing.pairs,
            "left unpaired": left,
            "right unpaired": right,
            "right after left [ms]": apart_ms,
            "paired within [ms]": 1e-6 * pairing.within,
        }
        return diagnostics(now, f"{self._name}: pairs", "", level, message, values)
