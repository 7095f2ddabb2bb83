"""What a worker does: a plain function from bytes to a mapping, for any executor.

Its arguments and its result are of Python's own types, so that workers with another version of
Cairn can refuse a task in words.
"""

from __future__ import annotations

import json
import logging
import os
import socket
import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, Final

from cairn.cli.log_file import log_file
from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from cairn.limits.files import megabytes, read_bounded
from cairn.processes.lockstep import LockstepRun
from cairn.runtime.input_files import content_digest
from cairn_lab.batch.code_versions import PACKAGE, code_versions, differences, packages_in
from cairn_lab.batch.packing import component_specs
from cairn_lab.batch.task import (
    LOG,
    MOST_INPUT_BYTES,
    MOST_RESULT_BYTES,
    ROOT,
    RUN,
    TaskResult,
    digest,
    pack,
)

_RUN: Final = RUN.removeprefix(f"{ROOT}/")


class _KeptContents:
    """Contents of files that earlier tasks needed, by their digests, of limited size."""

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._contents: OrderedDict[str, bytes] = OrderedDict()

    def add(self, contents: Mapping[str, bytes]) -> None:
        """Keep contents; those that were not used for the longest are dropped beyond the size."""
        for name, content in contents.items():
            self._contents[name] = content
            self._contents.move_to_end(name)
        while sum(map(len, self._contents.values())) > self._most_bytes:
            self._contents.popitem(last=False)

    def get(self, name: str) -> bytes | None:
        """Return a content, None if it is not kept."""
        if name in self._contents:
            self._contents.move_to_end(name)
        return self._contents.get(name)


# A worker has nothing else that lives from task to task. The lock: a run in lockstep uses the
# logging of its process, so a worker with several threads makes one run at a time.
_KEPT: Final = _KeptContents(MOST_INPUT_BYTES)
_ONE_AT_A_TIME: Final = threading.Lock()


def worker_name(pid: int | None = None) -> str:
    """Return a name of a process of this computer, by default of this one."""
    return f"{socket.gethostname()} process {os.getpid() if pid is None else pid}"


def run_task(payload: bytes, contents: Mapping[str, bytes]) -> dict[str, Any]:
    """Run a task in lockstep; return a mapping with `worker`, and with one of these:

    - `refused`: why this worker cannot run it,
    - `missing`: digests of files that are neither in `contents` nor known from earlier tasks,
    - `result`: the compressed `TaskResult`, with its `digest`.
    """
    with _ONE_AT_A_TIME:
        return {"worker": worker_name()} | _answer(json.loads(payload), contents)


def _answer(task: Mapping[str, Any], contents: Mapping[str, bytes]) -> dict[str, Any]:
    required: Mapping[str, str] = task["code"]
    if differing := differences(required, code_versions(packages_in(required))):
        return {"refused": f"it has {', '.join(differing)}"}
    given = {content_digest(content): content for content in contents.values()}
    _KEPT.add(given)
    files: dict[str, bytes] = {}
    missing = []
    for name, wanted in task["files"].items():
        content = given.get(wanted) or _KEPT.get(wanted)
        if content is None:
            missing.append(wanted)
        else:
            files[name] = content
    if missing:
        return {"missing": sorted(set(missing))}
    result = _run(task, files).encode()
    return {"result": pack(result), "digest": digest(result)}


def _run(task: Mapping[str, Any], files: Mapping[str, bytes]) -> TaskResult:
    with TemporaryDirectory(prefix="cairn-task-") as scratch:
        root = Path(scratch).resolve()
        run = root / _RUN
        for name in (*task["folders"], _RUN):
            _below(root, name).mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            file = _below(root, name)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)
        for name in task["outputs"]:
            _below(run, name).parent.mkdir(parents=True, exist_ok=True)
        log = root / LOG
        ended = _run_logged(lambda: _deployment(task, root), int(task["seed"]), log)
        found = {LOG: log, **{name: _below(run, name) for name in task["outputs"]}}
        return _with_files(ended, found, root)


def _run_logged(deployment: Callable[[], Deployment], seed: int, log: Path) -> TaskResult:
    """Run a deployment with its log; any failure is the result's `error`."""
    logger = logging.getLogger(PACKAGE)
    propagate = logger.propagate
    logger.propagate = False  # failures are in the run's log and its result
    try:
        run = LockstepRun(deployment(), seed)
        with log_file(log, run.executor.now):
            end = run.run(lambda: None)
    except Exception as error:  # any failure: the other runs go on
        failure = str(error) if isinstance(error, CairnError) else repr(error)
        return TaskResult(False, False, failure, {}, error=failure)
    finally:
        logger.propagate = propagate
    return TaskResult(end.normal, end.success, end.reason, {})


def _deployment(task: Mapping[str, Any], root: Path) -> Deployment:
    here = json.dumps(str(root))[1:-1]
    document = json.loads(task["deployment"].replace(f"{ROOT}/", f"{here}/"))
    specs = dict(component_specs(document["components"]))
    for name, values in task["parameters"].items():
        specs[name]["parameters"] |= values
    return Deployment.model_validate_json(json.dumps(document))


def _with_files(ended: TaskResult, found: Mapping[str, Path], root: Path) -> TaskResult:
    """Return a result with these files as far as they exist, without the path of the folder."""
    here, there = str(root).encode(), ROOT.encode()
    files: dict[str, bytes] = {}
    left = MOST_RESULT_BYTES // 2  # the rest is for names and reasons
    for name, file in found.items():
        try:
            content = read_bounded(file, left).replace(here, there)
        except FileNotFoundError:
            continue
        except OSError as error:
            failure = (
                f"{name}: {error.strerror}; the files of a run may have "
                f"{megabytes(MOST_RESULT_BYTES // 2)} MB"
            )
            return TaskResult(False, False, failure, {}, error=failure)
        files[name] = content
        left -= len(content)
    reason, error_text = (text.replace(str(root), ROOT) for text in (ended.reason, ended.error))
    return TaskResult(ended.normal, ended.success, reason, files, error_text)


def _below(folder: Path, name: str) -> Path:
    """Return a path below a folder; raises `ValueError` if the name leads out of it."""
    pure = PurePosixPath(name)
    if pure.is_absolute() or ".." in pure.parts:
        raise ValueError(f"{name!r} leads out of the folder of a run")
    return folder / pure
