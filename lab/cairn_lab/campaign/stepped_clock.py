"""The clocks of a deployment's machines, which a campaign sets ahead and back.

A small library, preloaded into `cairn up` and so into all its processes, adds an offset to the
system time that they read. The computer's clock stays as it is, and so does the monotonic clock.
It is compiled here from `stepped_clock.c`, because libfaketime, which does the same, has
`time.sleep` fail if it leaves the monotonic clock as it is (0.9.10: clock_nanosleep with an
absolute time returns EINVAL).
"""

from __future__ import annotations

import os
import struct
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from cairn.system.clock import SECOND
from cairn_lab.campaign.fault import SkippedFault

_SOURCE: Final = Path(__file__).with_name("stepped_clock.c")
_COMPILER: Final = "cc"
_LIMIT_S: Final = 60.0
_PRELOAD: Final = "LD_PRELOAD"


class Clocks:
    """The offsets of the machines' clocks to that of this computer."""

    def __init__(self, machines: Sequence[str], folder: Path) -> None:
        """Take the machines whose clocks are stepped, if any.

        The folder gets the library, and a file `clock_MACHINE` with the offset of each.
        """
        self._offsets_ns = dict.fromkeys(machines, 0)
        self._folder = folder.absolute()
        self._library = self._folder / "stepped_clock.so"
        self._problem = _compile(self._library) if machines else "no fault has `needs_clocks`"
        for machine in machines:
            self._write(machine)

    def environment(self, machine: str) -> Mapping[str, str]:
        """Return the environment variables that give the processes of a machine its clock."""
        if self._problem:
            return {}
        others = os.environ.get(_PRELOAD, "")
        return {
            _PRELOAD: f"{self._library}:{others}".rstrip(":"),
            "CAIRN_CLOCK_OFFSET": str(self._file(machine)),
        }

    @contextmanager
    def stepped(self, machine: str, by_s: float) -> Iterator[None]:
        """Step the clock of a machine, and at the end by as much in the other direction.

        Raises `SkippedFault` if the deployment has no clocks of its own.
        """
        if self._problem:
            raise SkippedFault(f"the deployment has no clock of its own: {self._problem}")
        self._step(machine, by_s)
        try:
            yield
        finally:
            self._step(machine, -by_s)

    def _step(self, machine: str, by_s: float) -> None:
        self._offsets_ns[machine] += round(by_s * SECOND)
        self._write(machine)

    def _write(self, machine: str) -> None:
        file = os.open(self._file(machine), os.O_WRONLY | os.O_CREAT, 0o600)
        try:
            os.pwrite(file, struct.pack("=q", self._offsets_ns[machine]), 0)
        finally:
            os.close(file)

    def _file(self, machine: str) -> Path:
        return self._folder / (f"clock_{machine}" if machine else "clock")


def _compile(library: Path) -> str:
    """Compile the library; return why it cannot be used, or ""."""
    if set(str(library)) & set(" :"):  # they separate the libraries in LD_PRELOAD
        return f"there is a space or a colon in {library}; name another folder for the report"
    command = [_COMPILER, "-shared", "-fPIC", "-O2", "-o", str(library), str(_SOURCE), "-ldl"]
    try:
        subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=True)
    except FileNotFoundError:
        return (
            f"there is no C compiler `{_COMPILER}` (Debian, Ubuntu: apt-get install gcc libc6-dev)"
        )
    except subprocess.CalledProcessError as error:
        return f"`{_COMPILER}` cannot compile {_SOURCE}: {error.stderr.strip()[-500:]}"
    except subprocess.TimeoutExpired:
        return f"`{_COMPILER}` took longer than {_LIMIT_S:g} s"
    return ""
