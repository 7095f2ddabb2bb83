"""Imports a deployment's modules in the zygote, and finds those that fail or start threads."""

import importlib
import os
import traceback
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

_TRACEBACK_LINES = 12


@dataclass
class Preloaded:
    """What came of importing the modules."""

    failures: dict[str, str] = field(default_factory=dict)  # module: error and traceback's tail
    threads: dict[str, list[str]] = field(default_factory=dict)  # module: names of threads it left

    def refusal(self, needs: Iterable[str]) -> str:
        """Why a process that needs these modules cannot start, "" if it can."""
        failed = [module for module in needs if module in self.failures]
        return "; ".join(
            f"the module {module} cannot be imported: {self.failures[module]}" for module in failed
        )


def preload(modules: Iterable[str]) -> Preloaded:
    """Import modules; none of their errors keeps the others from being imported."""
    preloaded = Preloaded()
    before = _threads()
    for module in modules:
        try:
            importlib.import_module(module)
        except (Exception, SystemExit) as error:  # a plugin's module may fail in any way
            preloaded.failures[module] = _told(error)
        after = _threads()
        started = [after[thread] for thread in sorted(after.keys() - before.keys())]
        if started:
            preloaded.threads[module] = started
        before = after
    return preloaded


def _told(error: BaseException) -> str:
    trace = "".join(traceback.format_exception(error)).rstrip().splitlines()
    tail = "\n".join(trace[-_TRACEBACK_LINES:])
    return f"{type(error).__name__}: {error}\n{tail}"


def _threads() -> dict[int, str]:
    """Thread id and name of all threads of this process, native ones included."""
    names: dict[int, str] = {}
    for entry in Path("/proc/self/task").iterdir():
        try:
            names[int(entry.name)] = (entry / "comm").read_text().strip()
        except (FileNotFoundError, ProcessLookupError):  # it ended while being looked at
            continue
    names.pop(os.getpid(), None)
    return names
