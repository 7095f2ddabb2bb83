"""Calls a function in a process forked from the zygote, so that the caller need not import much.

The zygote has imported the modules that the function uses. Argument and result are JSON.
"""

import importlib
import json
import socket
from contextlib import closing
from typing import Any, NoReturn, TextIO

from cairn.errors import CairnError
from cairn.processes.child import ZygoteLost
from cairn.processes.launcher import ZygoteClient, ZygoteProcess
from cairn.runtime.process_exit import ExitLog, end_process

_ENTRY = f"{__name__}:answer"
_END_LIMIT_S = 10.0  # of a process that has closed its socket


def call_in_fork(
    zygote: ZygoteProcess, name: str, function: str, argument: Any, *, timeout_s: float
) -> Any:
    """Call a function ("package.module:function") in a fork of the zygote; return its result.

    It takes the argument; this and its result are what JSON can carry. `name` is the name of the
    process. The zygote has `timeout_s` [s] to finish its imports; the function may take any time.
    Raises `CairnError` with the text of the function's own, or if the zygote or the process ends
    without an answer.
    """
    log = ExitLog(zygote.log_file)
    own, passed = socket.socketpair()
    with own, passed:
        try:
            with closing(ZygoteClient(zygote.socket_path, timeout_s=timeout_s)) as client:
                process = client.spawn(name, _ENTRY, {}, zygote.log_file, channel=passed)
                passed.close()  # the end of the process is then the end of the stream
                try:
                    with own.makefile("rw", encoding="utf-8") as stream:
                        _write(stream, [function, argument])
                        result, error = json.loads(stream.readline())
                except (OSError, ValueError):
                    exited = process.wait(_END_LIMIT_S)
                    code = None if exited is None else exited.code
                    raise _ended(f"process {name}", log, process.pid, code) from None
        except ZygoteLost:
            code = zygote.process.wait(_END_LIMIT_S)
            raise _ended("the zygote", log, zygote.process.pid, code) from None
    if error is not None:
        raise CairnError(error)
    return result


def answer(_: dict[str, Any], end: socket.socket) -> NoReturn:
    """Answer a call that comes from `call_in_fork`: what its process runs."""
    with end, end.makefile("rw", encoding="utf-8") as stream:
        function, argument = json.loads(stream.readline())
        module, _, name = function.partition(":")
        result, error = None, None
        try:
            result = getattr(importlib.import_module(module), name)(argument)
        except CairnError as failure:
            error = str(failure)
        _write(stream, [result, error])
    end_process(0)  # to free all that the zygote has imported would take longer than the call


def _write(stream: TextIO, line: Any) -> None:
    json.dump(line, stream)
    stream.write("\n")
    stream.flush()


def _ended(process: str, log: ExitLog, pid: int, code: int | None) -> CairnError:
    reason = "it does not end" if code is None else log.report(pid, code).reason
    return CairnError(f"{process} failed before anything was started: {reason} (log {log.file})")
