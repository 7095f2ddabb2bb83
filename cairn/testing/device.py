"""What a test can do with the device under a driver: an emulated one, or a real one with a switch.

A fixture `device` returns an object with as many of these abilities as the device has. What it
cannot do is not tested, and the test is skipped with that reason.
"""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable


@runtime_checkable
class Located(Protocol):
    """A device that is found at another place in every run, such as an emulator's port."""

    @property
    def settings(self) -> Mapping[str, Any]:
        """Settings of the deployment that say where the device is, as in `--set NAME=VALUE`."""
        ...


@runtime_checkable
class Routed(Protocol):
    """A device that is a ROS 2 node, and reached over a router that runs already."""

    @property
    def router(self) -> str:
        """Endpoint of that router, which the deployment joins: `tcp/127.0.0.1:7447`."""
        ...


@runtime_checkable
class Unpluggable(Protocol):
    """A device that can be taken away and given back."""

    def unplug(self) -> None:
        """Take it away, as if somebody pulled its cable."""
        ...

    def plug_in(self) -> None:
        """Give it back; does nothing if it is there."""
        ...


@runtime_checkable
class Wheeled(Protocol):
    """A base whose wheels can be watched without its driver."""

    def turns(self) -> bool:
        """Whether a wheel turns now."""
        ...

    def await_stand(self, limit_s: float) -> bool:
        """Wait until no wheel turns; whether that was so within the limit [s]."""
        ...
