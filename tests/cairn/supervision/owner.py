"""An owner of processes, as a test of the zygote uses it."""

import queue
from pathlib import Path
from typing import Any

from cairn.supervision.child_process import ChildExit, ChildProcess
from cairn.supervision.zygote_client import ZygoteClient, ZygoteLost
from cairn.supervision.zygote_process import ZygoteProcess

from . import zygote_children
from .reports import Report, Reports


class Owner:
    """A client of the zygote, as a test uses it."""

    def __init__(self, zygote: ZygoteProcess, reports: Reports, log: Path) -> None:
        self.exits: queue.Queue[ChildExit] = queue.Queue()
        self.losses: queue.Queue[ZygoteLost] = queue.Queue()
        self.client = ZygoteClient(zygote.socket_path, self.exits.put, self.losses.put)
        self.reports = reports
        self.log = log
        self.facts = {"reports": reports.path, "zygote": str(zygote.socket_path), "log": str(log)}

    def spawn(self, entry: str, name: str = "driver", **argument: Any) -> ChildProcess:
        fresh = argument.pop("fresh", False)
        return self.client.spawn(
            name,
            f"{zygote_children.__name__}:{entry}",
            {"name": name, **self.facts, **argument},
            self.log,
            fresh=fresh,
        )

    def running(self, entry: str, name: str = "driver", **argument: Any) -> Report:
        """The report of a process just spawned."""
        self.spawn(entry, name, **argument)
        return self.reports.of(name)
