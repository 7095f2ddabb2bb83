"""Calls a function in a process forked from the zygote, so that the caller need not import much.

The zygote has imported the modules that the function uses. Call and answer are pickled: both
processes belong to one run, and nothing else can write to the socket between them.
"""

import pickle
import socket
from collections.abc import Callable
from contextlib import closing
from typing import Any, TypeVar

from cairn.errors import CairnError
from cairn.process_exit import ExitLog
from cairn.supervision.child import ZygoteLost
from cairn.supervision.zygote_client import ZygoteClient, ZygoteProcess

T = TypeVar("T")

_ENTRY = f"{__name__}:answer"
_END_LIMIT_S = 10.0  # of a process that has closed its socket


def call_in_fork(
    zygote: ZygoteProcess,
    name: str,
    function: Callable[..., T],
    *arguments: object,
    timeout_s: float,
) -> T:
    """Call a module's function in a fork of the zygote, and return its result.

    `name` is the name of the process. The zygote has `timeout_s` [s] to finish its imports; the
    function may take any time. Raises `CairnError` with the text of the function's own, or if the
    zygote or the process ends without an answer.
    """
    log = ExitLog(zygote.log_file)
    own, passed = socket.socketpair()
    with own, passed:
        try:
            with closing(ZygoteClient(zygote.socket_path, timeout_s=timeout_s)) as client:
                process = client.spawn(name, _ENTRY, {}, zygote.log_file, channel=passed)
                passed.close()  # the end of the process is then the end of the stream
                try:
                    with own.makefile("rwb") as stream:
                        pickle.dump((function, arguments), stream)
                        stream.flush()
                        result, error = pickle.load(stream)
                except (OSError, EOFError):
                    exited = process.wait(_END_LIMIT_S)
                    code = None if exited is None else exited.code
                    raise _ended(f"process {name}", log, process.pid, code) from None
        except ZygoteLost:
            code = zygote.process.wait(_END_LIMIT_S)
            raise _ended("the zygote", log, zygote.process.pid, code) from None
    if error is not None:
        raise CairnError(error)
    answered: T = result
    return answered


def answer(_: dict[str, Any], end: socket.socket) -> None:
    """Answer a call that comes from `call_in_fork`: what its process runs."""
    with end, end.makefile("rwb") as stream:
        function, arguments = pickle.load(stream)
        result, error = None, None
        try:
            result = function(*arguments)
        except CairnError as failure:
            error = str(failure)
        pickle.dump((result, error), stream)


def _ended(process: str, log: ExitLog, pid: int, code: int | None) -> CairnError:
    reason = "it does not end" if code is None else log.report(pid, code).reason
    return CairnError(f"{process} failed before anything was started: {reason} (log {log.file})")
