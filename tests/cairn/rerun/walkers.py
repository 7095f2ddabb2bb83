"""Components whose re-run must be exact: with timers, randomness, posts, requests and files."""

import ctypes
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from cairn import CairnError, Component, Config, In, Out, ReadPath, every, from_ns, on
from cairn.schemas.geometry_msgs import Twist, TwistStamped, Vector3
from cairn.schemas.std_msgs import Header


class WalkerConfig(Config):
    step: float = Field(1.0, description="Length of a step [m].")
    names: ReadPath | None = Field(None, description="A file with words.")
    state_file: Path | None = Field(None, description="Keeps the position.")


class Walker(Component):
    """Walks at random; publishes where it is, stamped by its clock."""

    config: WalkerConfig
    push: In[TwistStamped] = In(optional=True)
    position: Out[TwistStamped]
    corner: Out[TwistStamped]

    x = 0.0

    def on_configure(self) -> None:
        if self.config.state_file is not None and self.config.state_file.exists():
            self.x = float(self.config.state_file.read_text())
        words = "" if self.config.names is None else self.config.names.read_text()
        self.x += len(words)

    @every(hz=10)
    def walk(self) -> None:
        self.x += self.config.step * float(self.random.normal())
        self.position.publish(self._at(self.x))
        if self.config.state_file is not None:
            self.config.state_file.write_text(str(self.x))

    @on("push")
    def receive_push(self, push: TwistStamped) -> None:
        before = self.clock.now()
        self.x += push.twist.linear.x / 3
        self.post(lambda: self.corner.publish(self._at(self.x)))
        self.schedule(before + 30_000_000, lambda: self.corner.publish(self._at(-self.x)))

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        if verb == "jump":
            self.x += arguments["by"]
            return self.x
        if verb == "fail":
            self.post(self._fail)
            return None
        return super().on_request(verb, arguments)

    def _fail(self) -> None:
        raise CairnError(f"broken at {self.x:.6f}")

    def _at(self, x: float) -> TwistStamped:
        return TwistStamped(
            header=Header(stamp=from_ns(self.clock.now())),
            twist=Twist(linear=Vector3(x=x, y=self.config.step)),
        )


CHANGE = "CAIRN_TEST_FRAGILE"
"""What this variable of the environment says, a `Fragile` does from 1.5 s of its clock on."""


class Fragile(Component):
    """Publishes the time of its clock, and has a thread; it breaks if the environment says so."""

    position: Out[TwistStamped]

    def on_activate(self) -> None:
        self._stopped = threading.Event()
        threading.Thread(target=self._stopped.wait).start()

    def on_deactivate(self) -> None:
        self._stopped.set()

    @every(hz=10)
    def tick(self) -> None:
        now = self.clock.now()
        if now >= 1_500_000_000:
            match os.environ.get(CHANGE):
                case "raise":
                    raise ValueError("it has become fragile")
                case "crash":
                    ctypes.string_at(0)
                case "hang":
                    self.hang()
        self.position.publish(TwistStamped(header=Header(stamp=from_ns(now))))

    def hang(self) -> None:
        """Wait for what never happens."""
        threading.Event().wait()


class Thermometer(Component):
    """Drives a device: its clock is that of the device."""

    clock_source = "device"
    position: Out[TwistStamped]

    @every(hz=10)
    def measure(self) -> None:
        self.position.publish(TwistStamped())


class Poller(Component):
    """Has a thread of its own that measures, and posts what it measured."""

    position: Out[TwistStamped]

    def on_activate(self) -> None:
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._measure)
        self._thread.start()

    def on_deactivate(self) -> None:
        self._stopped.set()
        self._thread.join()

    def _measure(self) -> None:
        while not self._stopped.wait(0.1):
            self.post(lambda: self.position.publish(TwistStamped()))
