"""A process just forked by the zygote: severs it from the zygote and runs its entry."""

import faulthandler
import gc
import importlib
import json
import os
import signal
import sys
from dataclasses import asdict, dataclass
from typing import Any, NoReturn, cast

from setproctitle import setproctitle

from cairn.supervision.linux import set_parent_death_signal

# Replaces the interpreter's search path by the caller's before anything of ours is imported.
BOOTSTRAP = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); "
    "from importlib import import_module; import_module(sys.argv[1]).main()"
)
# Python ignores these itself, and expects them to be ignored.
_KEPT = {signal.SIGPIPE, signal.SIGXFSZ, signal.SIGKILL, signal.SIGSTOP}


@dataclass(frozen=True)
class Job:
    """What a process is to do: call `entry` ("package.module:function") with `argument`."""

    name: str
    entry: str
    argument: dict[str, Any]

    def run(self) -> None:
        """Call the entry; what it raises ends the process with a traceback and exit code 1."""
        module, _, function = self.entry.partition(":")
        getattr(importlib.import_module(module), function)(self.argument)


def sever(zygote: int, log: int) -> None:
    """Make the calling process, a fork of the zygote, one on its own; all signals are blocked.

    It leads a process group, dies with the zygote, reads nothing, writes to the file descriptor
    `log`, and has default signal handlers again.
    """
    signal.set_wakeup_fd(-1)
    os.setpgid(0, 0)
    set_parent_death_signal(signal.SIGKILL)
    if os.getppid() != zygote:  # it ended before the signal was asked for
        os._exit(1)
    _read_nothing()
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)
    for number in signal.valid_signals() - _KEPT:
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_SETMASK, [])


def begin(job: Job) -> None:
    """Set up the interpreter of a process for its job."""
    setproctitle(f"cairn: {job.name}")
    cast("Any", sys.stdout).reconfigure(line_buffering=True)
    faulthandler.enable()
    gc.enable()


def become_fresh(job: Job) -> NoReturn:
    """Replace the calling process, already severed, by a new interpreter that does the job."""
    handed = os.memfd_create(job.name)
    os.write(handed, json.dumps(asdict(job)).encode())
    os.lseek(handed, 0, os.SEEK_SET)
    os.dup2(handed, 0)
    path = json.dumps(sys.path)
    os.execv(sys.executable, [sys.executable, "-P", "-c", BOOTSTRAP, path, __name__, job.name])


def main() -> None:
    """Do the job handed over on standard input; what `become_fresh` starts."""
    job = Job(**json.loads(sys.stdin.buffer.read()))
    _read_nothing()
    begin(job)
    job.run()


def _read_nothing() -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
