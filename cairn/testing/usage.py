"""What a process holds: threads, files, memory, child processes."""

from dataclasses import dataclass

import psutil


@dataclass(frozen=True)
class Usage:
    """What a process held at a moment; `memory` is its own, not shared with others [bytes]."""

    threads: int
    files: int
    children: int
    memory: int

    @classmethod
    def of(cls, pid: int) -> "Usage":
        """What the process holds now; raises `psutil.Error` if there is none of that id."""
        process = psutil.Process(pid)
        return cls(
            threads=process.num_threads(),
            files=process.num_fds(),
            children=len(process.children()),
            memory=process.memory_full_info().uss,
        )
