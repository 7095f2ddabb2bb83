"""The driver of Hokuyo's PBS-03JN."""

from __future__ import annotations

import time
from collections import deque
from functools import partial

from cairn.bus.qos import LATCHED, SENSOR
from cairn.clock import SECOND, from_ns
from cairn.component.component import Component
from cairn.component.handlers import every
from cairn.component.parameters import Config, ParameterRefused
from cairn.component.ports import Out
from cairn.driver.device_thread import DeviceThread
from cairn.driver.diagnostics import ERROR, OK, WARN, diagnostics
from cairn.driver.errors import DeviceError
from cairn.driver.rate import RateWindow
from components.pbs.config import PbsConfig
from components.pbs.conversation import Conversation, Measured
from components.pbs.scan_message import ScanShape
from planar.messages import transform_message
from schemas.diagnostic_msgs import DiagnosticArray
from schemas.sensor_msgs import LaserScan
from schemas.std_msgs import Header
from schemas.tf2_msgs import TFMessage

_MOST_WAITING = 5


class PbsScanner(Component):
    """Drives a PBS-03JN: 121 rays, 0.2 to 3 m, ten scans a second.

    Configured, it has been found to answer; active, it is asked for distances. One that is
    unplugged or falls silent is told of, and begun anew with.
    """

    clock_source = "device"
    config: PbsConfig

    scan: Out[LaserScan] = Out(qos=SENSOR)
    tf_static: Out[TFMessage] = Out(qos=LATCHED)
    diagnostics: Out[DiagnosticArray]

    def on_configure(self) -> None:
        """See that the sensor answers.

        One that was there before may come back: then it is waited for, once active.
        """
        self._rate = RateWindow()
        self._trouble = ""
        self._damaged_before = 0
        self._left_out = 0
        self._waiting: deque[Measured] = deque(maxlen=_MOST_WAITING)
        self._thread: DeviceThread | None = None
        self._shape = ScanShape(self.config.resolution, self.config.range_max)
        self._conversation = Conversation(self.config, self._came)
        try:
            self._conversation.probe()
        except DeviceError as error:
            if not self.restarts:
                raise
            self._trouble = str(error)

    def on_activate(self) -> None:
        """Tell where it sits on the robot; begin to measure."""
        header = Header(stamp=from_ns(self.clock.now()), frame_id="base_link")
        mounted = transform_message(header, self.config.frame_id, self.config.mount.pose)
        self.tf_static.publish(TFMessage(transforms=(mounted,)))
        self._rate.restart()
        self._waiting.clear()  # what came while it was being deactivated
        thread = DeviceThread(
            self.name,
            lambda stopping: self._conversation.converse(stopping, thread.well),
            log=self.log,
            on_trouble=lambda error: self.post(partial(self._lost, error)),
            on_failure=lambda error: self.post(partial(_fail, error)),
        )
        self._thread = thread
        thread.start()

    def on_deactivate(self) -> None:
        """End the link."""
        self._stop()

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - whatever it was
        """Let go of the sensor; the supervisor decides."""
        self._stop()
        return False

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """The sensor measures as it does."""
        raise ParameterRefused(f"{self.name} takes its parameters when it is configured")

    @every(hz=1)
    def report(self) -> None:
        """Tell how the sensor is."""
        hz = self._rate.hz(time.monotonic())
        level, text = self._judgement(hz)
        conversation = self._conversation
        values = {
            "port": self.config.port,
            "rate [Hz]": hz,
            "nominal rate [Hz]": self.config.rate,
            "scans": conversation.scans,
            "damaged frames": conversation.damaged,
            "left out": self._left_out,
            "requests without answer": conversation.missed,
            "connections": conversation.connections,
        }
        told = diagnostics(self.clock.now(), self.name, self.config.port, level, text, values)
        self.diagnostics.publish(told)

    def _judgement(self, hz: float) -> tuple[int, str]:
        damaged = self._conversation.damaged - self._damaged_before
        self._damaged_before += damaged
        if self._trouble:
            return ERROR, self._trouble
        if damaged:
            return WARN, f"{damaged} damaged frames: check cable and shielding"
        if abs(hz - self.config.rate) > self.config.rate_tolerance * self.config.rate:
            return WARN, f"{hz:.1f} scans a second, but {self.config.rate:g} are asked for"
        return OK, f"{hz:.1f} scans a second"

    def _came(self, measured: Measured) -> None:
        # On the sensor's thread. If scans are told more slowly than they come, the oldest go.
        if len(self._waiting) == _MOST_WAITING:
            self._left_out += 1
        self._waiting.append(measured)
        self.post(self._tell)

    def _tell(self) -> None:
        if not self._waiting:
            return
        measured = self._waiting.popleft()
        self._rate.note(time.monotonic())
        self._trouble = ""
        age_s = time.monotonic() - measured.began - self.config.time_offset_s
        stamp = self.clock.now() - round(age_s * SECOND)
        header = Header(stamp=from_ns(stamp), frame_id=self.config.frame_id)
        self.scan.publish(self._shape.scan(measured.distances, header))

    def _lost(self, error: DeviceError) -> None:
        self._trouble = str(error)
        self._rate.restart()

    def _stop(self) -> None:
        thread, self._thread = getattr(self, "_thread", None), None
        if thread is not None:
            thread.stop()


def _fail(error: Exception) -> None:
    raise error
