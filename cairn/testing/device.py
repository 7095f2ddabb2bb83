"""What a test can do with the device under a driver, which is emulated or real.

The fixture `device` returns an object that implements any of these protocols. Tests that need
another protocol are skipped, with the reason.
"""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Located(Protocol):
    """A device whose address differs from run to run, such as an emulator's port."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the deployment with the device's address, as in `--set NAME=VALUE`."""


@runtime_checkable
class Routed(Protocol):
    """A device behind a ROS 2 node, which is reached over a running router."""

    @property
    def router(self) -> str:
        """Endpoint of the router that the deployment joins, such as `tcp/127.0.0.1:7447`."""


@runtime_checkable
class Unpluggable(Protocol):
    """A device that can be unplugged."""

    def unplug(self) -> None:
        """Disconnect the device, as if its cable were pulled."""

    def plug_in(self) -> None:
        """Connect the device again; no effect if it is connected."""


@runtime_checkable
class Wheeled(Protocol):
    """A base whose wheels can be observed without its driver."""

    def turns(self) -> bool:
        """Return whether a wheel is turning."""

    def await_stand(self, limit_s: float) -> bool:
        """Wait until no wheel turns; return whether that happened within the limit [s]."""
