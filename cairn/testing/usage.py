"""What a process holds: what a driver that leaks takes more and more of."""

import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

_OF_THE_BUS = re.compile(r"(acc|app|net|rx|tx)-\d+")
"""Names of Zenoh's threads, which come and go with its work."""


@dataclass(frozen=True)
class Usage:
    """What a process held at a moment; `memory` is its own, not shared with others [bytes].

    Threads of the bus are not counted: they are not the component's.
    """

    threads: int
    files: int
    children: int
    memory: int

    @classmethod
    def of(cls, pid: int) -> "Usage":
        """What the process holds now; raises `psutil.Error` if there is none of that id."""
        process = psutil.Process(pid)
        return cls(
            threads=sum(not _OF_THE_BUS.fullmatch(name) for name in _threads_of(process)),
            files=process.num_fds(),
            children=len(process.children()),
            memory=process.memory_full_info().uss,
        )


def _threads_of(process: psutil.Process) -> list[str]:
    names = []
    for thread in process.threads():
        with suppress(OSError):  # it has just ended
            name = Path(f"/proc/{process.pid}/task/{thread.id}/comm").read_text(encoding="utf-8")
            names.append(name.rstrip("\n"))
    return names
