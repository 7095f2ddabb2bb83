"""Tells the service manager how a deployment gets on: systemd's protocol, sd_notify(3).

Without a service manager nothing is told.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import MutableMapping
from contextlib import suppress

_BEATS = 3
"""Within the watchdog's time: one may be late, and one lost."""


class ServiceManager:
    """Whoever started us and wants to be told; nobody, if the address is empty."""

    def __init__(self, address: str = "", watchdog_s: float = 0.0) -> None:
        """`address` is a path, or `@` with a name; `watchdog_s` is 0 without a watchdog."""
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._period_s = watchdog_s / _BEATS
        self._beaten_at = 0.0
        self._ready = False
        self._stopping = False

    def tell(self, *, active: bool, sound: bool) -> None:
        """Tell what has changed; called again and again, as long as the deployment runs.

        `active` says whether its root is, `sound` whether the root gets on with what it does: a
        watchdog that is not fed has all killed and started anew.
        """
        if not self._address:
            return
        if active and not self._ready:
            self._ready = True
            self._send("READY=1\nSTATUS=active")
        if self._ready and not active and not self._stopping:
            self._stopping = True
            self._send("STOPPING=1\nSTATUS=stopping")
        now = time.monotonic()
        # Not before it is ready: the first beat starts the watchdog, and a start may be slow.
        if self._ready and self._period_s and sound and now - self._beaten_at >= self._period_s:
            self._beaten_at = now
            self._send("WATCHDOG=1")

    def _send(self, message: str) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
            sender.setblocking(False)
            # A manager that is busy or restarts hears the next one: no robot waits for it.
            with suppress(BlockingIOError, ConnectionRefusedError, FileNotFoundError):
                sender.sendto(message.encode(), self._address)


def service_manager(environment: MutableMapping[str, str]) -> ServiceManager:
    """The service manager that the environment names.

    What it says is taken out of it: it is for this process, and not for those that it starts.
    """
    address = environment.pop("NOTIFY_SOCKET", "")
    microseconds = environment.pop("WATCHDOG_USEC", "0")
    for_us = environment.pop("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return ServiceManager(address, int(microseconds) / 1e6 if for_us else 0.0)
