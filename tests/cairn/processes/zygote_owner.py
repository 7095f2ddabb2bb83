"""An owner of processes, as a test of the zygote uses it."""

import queue
from pathlib import Path
from typing import Any

from cairn.processes.child import ZygoteLost
from cairn.processes.launcher import ChildProcess, ZygoteClient, ZygoteProcess
from cairn.processes.zygote import Exited
from tests.patience import LIMIT_S

from . import zygote_children
from .reports import Report, Reports


class Owner:
    """A client of the zygote, with the exits and losses that it was notified of."""

    def __init__(self, zygote: ZygoteProcess, reports: Reports, log: Path) -> None:
        self.exits: queue.Queue[Exited] = queue.Queue()
        self.losses: queue.Queue[ZygoteLost] = queue.Queue()
        self.client = ZygoteClient(zygote.socket_path, self.losses.put)
        self.reports = reports
        self.log = log
        self.facts = {"reports": reports.path, "zygote": str(zygote.socket_path), "log": str(log)}

    def spawn(self, entry: str, name: str = "driver", **argument: Any) -> ChildProcess:
        fresh = argument.pop("fresh", False)
        child = self.client.spawn(
            name,
            f"{zygote_children.__name__}:{entry}",
            {"name": name, **self.facts, **argument},
            self.log,
            fresh=fresh,
            timeout_s=LIMIT_S,
        )
        child.on_exit(self.exits.put)
        return child

    def spawn_reporting(self, entry: str, name: str = "driver", **argument: Any) -> Report:
        """Spawn a process and return its report."""
        self.spawn(entry, name, **argument)
        return self.reports.of(name)
