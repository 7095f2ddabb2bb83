"""The actions of a test on the device under a driver: emulated, or real with a switch.

A fixture `device` returns an object with the abilities that the device has. Tests that need others
are skipped, with the reason.
"""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Located(Protocol):
    """A device with another address in every run, such as an emulator's port."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the deployment with the device's address, as in `--set NAME=VALUE`."""
        ...


@runtime_checkable
class Routed(Protocol):
    """A device that is a ROS 2 node, reached over a router that runs already."""

    @property
    def router(self) -> str:
        """Endpoint of that router, which the deployment joins: `tcp/127.0.0.1:7447`."""
        ...


@runtime_checkable
class Unpluggable(Protocol):
    """A device that can be unplugged."""

    def unplug(self) -> None:
        """Unplug the device, as if its cable were pulled."""
        ...

    def plug_in(self) -> None:
        """Plug it in again; does nothing if it is plugged in."""
        ...


@runtime_checkable
class Wheeled(Protocol):
    """A base whose wheels can be observed without its driver."""

    def turns(self) -> bool:
        """Return whether a wheel turns now."""
        ...

    def await_stand(self, limit_s: float) -> bool:
        """Wait until no wheel turns; return whether that happened within the limit [s]."""
        ...
