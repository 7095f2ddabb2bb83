"""Reports the state of a deployment to systemd, or another service manager (sd_notify(3)).

Without a service manager it does nothing. Libraries for it need libsystemd (systemd-python) or have
had no release for years (sdnotify), and leave the watchdog's timing, most of this file, to us.
"""

from __future__ import annotations

import logging
import math
import os
import socket
import time
from collections.abc import MutableMapping

_BEATS = 3
"""Keep-alive messages within the watchdog's time: one may be late, and one may be lost."""


class ServiceManager:
    """The service manager that has started this process; an empty address means there is none."""

    def __init__(self, address: str = "", watchdog_s: float = 0.0) -> None:
        """`address` is a path, or `@` with a name; `watchdog_s` is 0 without a watchdog."""
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._period_s = watchdog_s / _BEATS
        self._last_beat_at = -math.inf
        self._ready = False
        self._stopping = False
        self._failed = False

    def notify(self, *, active: bool, healthy: bool) -> None:
        """Report what has changed; to be called repeatedly as long as the deployment runs.

        `active`: the root is active. `healthy`: the root makes progress; when it does not, the
        watchdog gets no more messages, and systemd kills and restarts everything.
        """
        if not self._address:
            return
        if active and not self._ready:
            self._ready = self._send("READY=1\nSTATUS=active")
        if self._ready and not active and not self._stopping:
            self._stopping = self._send("STOPPING=1\nSTATUS=stopping")
        now = time.monotonic()
        # Not before it is ready: the first beat starts the watchdog, and a start may be slow.
        if (
            self._ready
            and self._period_s
            and healthy
            and now - self._last_beat_at >= self._period_s
        ):
            self._last_beat_at = now
            self._send("WATCHDOG=1")

    def _send(self, message: str) -> bool:
        """Send a message if the manager can take it now; return whether it has.

        A manager that is busy or restarts gets it, or the next one, later: the robot must not wait.
        """
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
                sender.setblocking(False)
                sender.sendto(message.encode(), self._address)
                return True
        except (BlockingIOError, ConnectionRefusedError, FileNotFoundError):
            return False
        except OSError as error:  # must not end the robot
            if not self._failed:
                reason = f"{self._address!r}: {error.strerror}; correct NOTIFY_SOCKET"
                logging.getLogger("cairn").error("service manager not notified: %s", reason)
            self._failed = True
            return False


def service_manager(environment: MutableMapping[str, str]) -> ServiceManager:
    """Return the service manager that the environment names.

    Its variables are removed from the environment: child processes must not use them.
    """
    address = environment.pop("NOTIFY_SOCKET", "")
    microseconds = environment.pop("WATCHDOG_USEC", "0")
    for_us = environment.pop("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return ServiceManager(address, int(microseconds) / 1e6 if for_us else 0.0)
