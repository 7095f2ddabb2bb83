"""A component that fails on demand, in every way that a component can."""

import ctypes
import os
import subprocess
import sys
import time
from typing import Literal

from pydantic import Field

from cairn import Component, Config, Out, every
from cairn.runtime.component import ComponentContext
from cairn.schemas.geometry_msgs import Twist, Vector3

Fault = Literal[
    "none",
    "raise",
    "nap",
    "sleep",
    "hold_gil",
    "abort",
    "exit",
    "sys_exit",
    "publish_nan",
    "grow",
    "allocate",
    "orphan",
]
Where = Literal["constructor", "on_configure", "on_activate", "on_shutdown", "tick"]


class FaultyConfig(Config):
    """The fault, and the call in which it occurs."""

    fault: Fault = Field("none", description="The fault; may be set while running.")
    where: Where = Field("tick", description="The call in which it occurs.")
    once: str = Field("", description="A file that the first start creates; all later starts fail.")
    helpers: int = Field(0, ge=0, description="Number of helper processes to start [1].")


class Faulty(Component):
    """Ticks fifty times per second until it fails on demand."""

    config: FaultyConfig
    velocity: Out[Twist] = Out()

    def __init__(self, context: ComponentContext) -> None:
        """Fail if the configuration says so."""
        super().__init__(context)
        self._filled = b""
        assert isinstance(context.config, FaultyConfig)
        if context.config.where == "constructor":
            self._fail(context.config.fault)

    def on_configure(self) -> None:
        """Start the helpers, every second one in a session of its own."""
        for index in range(self.config.helpers):
            subprocess.Popen(["sleep", "1000"], start_new_session=index % 2 == 1)
        if self.config.once:
            with open(self.config.once, "x"):
                pass
        self._fail_at("on_configure")

    def on_activate(self) -> None:
        """Fail if the configuration says so."""
        self._fail_at("on_activate")

    def on_shutdown(self) -> None:
        """Fail if the configuration says so."""
        self._fail_at("on_shutdown")

    @every(hz=50)
    def tick(self) -> None:
        """Fail if the configuration says so."""
        self._fail_at("tick")

    def _fail_at(self, where: Where) -> None:
        if self.config.where == where:
            self._fail(self.config.fault)

    def _fail(self, fault: Fault) -> None:
        match fault:
            case "none":
                return
            case "raise":
                raise ValueError("broken on purpose")
            case "nap":
                time.sleep(4)
            case "sleep":
                time.sleep(1000)
            case "hold_gil":
                ctypes.PyDLL(None).sleep(1000)  # one call into C that lets no other thread run
            case "abort":
                os.abort()
            case "exit":
                os._exit(3)
            case "sys_exit":
                sys.exit(3)
            case "publish_nan":
                self.velocity.publish(Twist(linear=Vector3(x=float("nan"))))
            case "grow":
                self._filled = b"x" * (160 << 20)
            case "allocate":
                bytes(2 << 30)
            case "orphan":
                subprocess.Popen(["sh", "-c", "sleep 1000 & exit 0"]).wait()
