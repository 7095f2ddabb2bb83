"""The clocks of a deployment's machines, which a campaign sets ahead and back.

The library libfaketime, preloaded into `cairn up` and so into all its processes, adds an offset to
what they read as the system time. The offset is read from a file each time (7 us), so that it
changes for all processes of a machine at once. The computer's clock stays as it is, and so does the
monotonic clock. (https://github.com/wolfcw/libfaketime)
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cairn.campaign.faults import SkippedFault
from cairn.clock import SECOND
from cairn.files import replace_file

_PROGRAM: Final = "faketime"
_LIMIT_S: Final = 10.0


class Clocks:
    """The offsets of the machines' clocks to that of this computer."""

    def __init__(self, machines: Sequence[str], folder: Path) -> None:
        """Take the machines whose clocks are stepped, if any.

        Their offsets [s] are kept in the folder, in files `clock_MACHINE`.
        """
        self._offsets_ns = dict.fromkeys(machines, 0)
        self._folder = folder
        self._library = _library() if machines else ""
        if self._library:
            for machine in machines:
                self._write(machine)

    def environment(self, machine: str) -> Mapping[str, str]:
        """Return the environment variables that give the processes of a machine its clock."""
        if not self._library:
            return {}
        return {
            "LD_PRELOAD": self._library,
            "FAKETIME_TIMESTAMP_FILE": str(self._file(machine)),
            "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1",
            "FAKETIME_DISABLE_SHM": "1",  # which a process that is killed leaves behind
        }

    @contextmanager
    def stepped(self, machine: str, by_s: float) -> Iterator[None]:
        """Step the clock of a machine, and at the end by as much in the other direction."""
        if not self._library:
            raise SkippedFault(
                "libfaketime is not installed, which gives the deployment a clock of its own "
                "(Debian, Ubuntu: apt-get install faketime)"
            )
        self._step(machine, by_s)
        try:
            yield
        finally:
            self._step(machine, -by_s)

    def _step(self, machine: str, by_s: float) -> None:
        self._offsets_ns[machine] += round(by_s * SECOND)
        self._write(machine)

    def _write(self, machine: str) -> None:
        seconds = self._offsets_ns[machine] / SECOND
        replace_file(self._file(machine), f"{seconds:+.9f}\n".encode(), durable=False)

    def _file(self, machine: str) -> Path:
        return self._folder / (f"clock_{machine}" if machine else "clock")


def _library() -> str:
    """Return what is to be preloaded, as the program of the library does it; "" without it."""
    command = [_PROGRAM, "-m", "-f", "+0", "printenv", "LD_PRELOAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
