"""Events of the kernel about devices that appear and vanish."""

import select
import socket
import time
from pathlib import Path

_KERNELS_OWN = 1  # multicast group, include/linux/netlink.h: NETLINK_KOBJECT_UEVENT
_KOBJECT_UEVENT = 15
_LONGEST = 8192


class DeviceEvents:
    """The kernel's events of devices, from the moment on that it is made."""

    def __init__(self) -> None:
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC
        self._socket = socket.socket(socket.AF_NETLINK, kind, _KOBJECT_UEVENT)
        self._socket.bind((0, _KERNELS_OWN))

    def __enter__(self) -> "DeviceEvents":
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def await_node(self, node: Path, *, there: bool, limit_s: float = 30.0) -> None:
        """Wait until a device's node exists, or no longer exists.

        The kernel makes and removes the node before it reports that. Raises `AssertionError`
        after the limit.
        """
        deadline = time.monotonic() + limit_s
        while node.exists() is not there:
            left_s = max(0.0, deadline - time.monotonic())
            readable, _, _ = select.select([self._socket], [], [], left_s)
            problem = "does not appear" if there else "does not vanish"
            assert readable, f"{node} {problem} within {limit_s:g} s"
            self._socket.recv(_LONGEST)
