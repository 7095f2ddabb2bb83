"""A process that the zygote has just forked: detaches it from the zygote and calls its entry."""

import faulthandler
import gc
import importlib
import json
import os
import signal
import sys
from typing import Any, NoReturn, cast

from setproctitle import setproctitle

from cairn.supervision.orphan_cleanup import set_parent_death_signal

# Replaces the interpreter's search path by the caller's before any module of Cairn is imported.
BOOTSTRAP = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); "
    "from importlib import import_module; import_module(sys.argv[1]).main()"
)
# Python itself ignores the first two and expects that; the others cannot be changed.
_UNCHANGED = {signal.SIGPIPE, signal.SIGXFSZ, signal.SIGKILL, signal.SIGSTOP}


def detach(zygote: int, log: int) -> None:
    """Detach the calling process, a fork of the zygote; all signals are blocked at the call.

    It becomes the leader of a process group, dies with the zygote, reads nothing, writes to the
    file descriptor `log`, and has the default signal handlers again.
    """
    signal.set_wakeup_fd(-1)
    os.setpgid(0, 0)
    set_parent_death_signal(signal.SIGKILL)
    if os.getppid() != zygote:  # the zygote ended before the signal was set
        os._exit(1)
    _close_input()
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)
    for number in signal.valid_signals() - _UNCHANGED:
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.pthread_sigmask(signal.SIG_SETMASK, [])


def run_entry(name: str, entry: str, argument: dict[str, Any]) -> None:
    """Set up the interpreter of a detached process and call `entry` ("package.module:function").

    An exception of the entry ends the process with a traceback and exit code 1.
    """
    setproctitle(f"cairn: {name}")
    cast("Any", sys.stdout).reconfigure(line_buffering=True)
    faulthandler.enable()
    gc.enable()
    module, _, function = entry.partition(":")
    getattr(importlib.import_module(module), function)(argument)


def run_in_fresh_interpreter(name: str, entry: str, argument: dict[str, Any]) -> NoReturn:
    """Replace the calling process, already detached, by a new interpreter that runs the entry."""
    passed = os.memfd_create(name)
    os.write(passed, json.dumps([name, entry, argument]).encode())
    os.lseek(passed, 0, os.SEEK_SET)
    os.dup2(passed, 0)
    path = json.dumps(sys.path)
    os.execv(sys.executable, [sys.executable, "-P", "-c", BOOTSTRAP, path, __name__, name])


def main() -> None:
    """Run the entry that `run_in_fresh_interpreter` has passed on standard input."""
    name, entry, argument = json.loads(sys.stdin.buffer.read())
    _close_input()
    run_entry(name, entry, argument)


def _close_input() -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
