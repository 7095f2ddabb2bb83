"""Apply deliberate faults to a copy of the code, and report which of them the tests catch.

Each job works in a scratch folder of its own, with a copy of the files that git tracks. A fault is
caught if a test fails, fails again when it runs alone, and passes without the fault. It is also
caught if the tests exceed the time limit with the fault and pass within it without the fault. The
exit status is 1 if a fault is missed.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import Queue
from uuid import uuid4

import psutil
from rich.console import Console
from rich.table import Column, Table

from cairn_lab.mutation.faults import (
    NO_TEST,
    ROOT,
    Fault,
    mutated,
    problems,
    read_faults,
    write_faults,
)

_MARK = "CAIRN_MUTATION"
_PYTEST = [
    sys.executable,
    "-m",
    "pytest",
    "-x",
    "-q",
    "-p",
    "no:cacheprovider",
    "-m",
    "not accuracy",
]
"""Only the tests of `make test` count."""
_FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/.*?)(?:\[.*| - .*)?$", re.MULTILINE)
# `cairn` contains components, schemas, supervisors and deploy by symbolic links to folders next to
# it; the copy keeps these links.
_PACKAGES = ("cairn", "cairn_lab", "tests", "cairn_test_plugins")
# Prints the files from which a child process imports the packages and the entry points.
_PRINT_ORIGINS = f"""
import importlib.metadata, importlib.util
entries = importlib.metadata.distribution("cairn-robotics").entry_points
for module in [*{_PACKAGES}, *(entry.module for entry in entries)]:
    print(importlib.util.find_spec(module).origin)
"""


@dataclass(frozen=True)
class Result:
    """The result of one fault; `caught_by` is a test, `timeout` or `none`.

    `unreliable` is a test (or `timeout`) that does not count, because it failed only once with the
    fault, or also fails without it.
    """

    id: str
    area: str
    caught_by: str
    unreliable: str
    seconds: float

    @property
    def caught(self) -> bool:
        """Whether a test caught the fault."""
        return self.caught_by != NO_TEST


class Scratch:
    """A copy of the code in which faults are applied and tests are run."""

    def __init__(self, root: Path, limit_s: float) -> None:
        self.root = root
        self._limit_s = limit_s
        tracked = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True
        )
        for name in filter(None, tracked.stdout.decode().split("\0")):
            if os.path.lexists(ROOT / name):  # it may have been deleted without a commit
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, root / name, follow_symlinks=False)
        # In another folder than the copy, as tests also start processes in other folders.
        command = [sys.executable, "-c", _PRINT_ORIGINS]
        output = self._run(command, tempfile.gettempdir(), root / ".numba")
        files = output.split()
        if not files or not all(file.startswith(f"{root}{os.sep}") for file in files):
            raise SystemExit(
                f"{root}: child processes import files from outside of this copy:\n{output}"
                "install the packages of the working tree again"
            )

    def judge(self, fault: Fault) -> Result:
        """Run the tests with the fault, and the failed test again with it and without it."""
        started = time.monotonic()
        with self._applied(fault) as cache:
            failed = self._first_failed(fault.tests, cache)
            again, unreliable = fault.tests if failed == "timeout" else (failed,), ""
            # On a busy machine a test may fail for another reason; then it passes when run alone.
            only_once = (
                failed not in (NO_TEST, "timeout") and self._first_failed(again, cache) == NO_TEST
            )
        if failed != NO_TEST and (
            only_once or self._first_failed(again, self.root / ".numba") != NO_TEST
        ):
            failed, unreliable = NO_TEST, failed
        seconds = round(time.monotonic() - started, 1)
        return Result(fault.id, fault.area, failed, unreliable, seconds)

    @contextmanager
    def _applied(self, fault: Fault) -> Iterator[Path]:
        """Apply a fault; yield the cache folder for kernels that are compiled with it."""
        # The working tree may change meanwhile, so the copy itself is what is restored.
        path = self.root / fault.file
        source, times = path.read_text("utf-8"), path.stat()
        # Numba does not compile a kernel again when another kernel that it calls has changed.
        kernels = "@compiled" in source or "@numba" in source
        cache = Path(tempfile.mkdtemp(dir=self.root)) if kernels else self.root / ".numba"
        path.write_text(mutated(fault, source), "utf-8")
        try:
            yield cache
        finally:
            path.write_text(source, "utf-8")
            # With its old time, so that .pyc files are written again.
            os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))

    def _first_failed(self, tests: Sequence[str], cache: Path) -> str:
        """Return the first test that fails, `timeout` or `none`."""
        try:
            output = self._run([*_PYTEST, *tests], str(self.root), cache)
        except subprocess.TimeoutExpired:
            return "timeout"
        found = _FAILED.search(output)
        if found is None and not re.search(
            r"^\d+ (passed|skipped|deselected)", output, re.MULTILINE
        ):
            return tests[0]  # pytest itself crashed
        return NO_TEST if found is None else found[1]

    def _run(self, command: Sequence[str], folder: str, cache: Path) -> str:
        """Run a command and return its output; kill all processes that it leaves behind."""
        mark = uuid4().hex
        folders = (self.root, self.root / "lab", self.root / "tests" / "plugin_package")
        process = subprocess.Popen(
            command,
            cwd=folder,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(map(str, folders)),
                "NUMBA_CACHE_DIR": str(cache),
                _MARK: mark,
            },
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        try:
            return process.communicate(timeout=self._limit_s)[0]
        finally:
            _kill_marked(mark)
            process.wait()


def _kill_marked(mark: str) -> None:
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.environ().get(_MARK) == mark:
                process.kill()


def _judge_all(faults: Sequence[Fault], jobs: int, limit_s: float) -> Iterator[Result]:
    with (
        tempfile.TemporaryDirectory(prefix="mutation-") as folder,
        ThreadPoolExecutor(jobs) as pool,
    ):
        free: Queue[Scratch] = Queue()
        for number in range(jobs):
            (root := Path(folder).resolve() / str(number)).mkdir()
            free.put(Scratch(root, limit_s))

        def judge(fault: Fault) -> Result:
            scratch = free.get()
            try:
                return scratch.judge(fault)
            finally:
                free.put(scratch)

        yield from pool.map(judge, faults)


def main() -> int:
    """Run the tests with each of the chosen faults."""
    parser = argparse.ArgumentParser("python -m cairn_lab.mutation", description=__doc__)
    parser.add_argument("ids", nargs="*", metavar="ID", help="faults to apply; by default all")
    parser.add_argument("--area", help="only the faults of this area")
    parser.add_argument(
        "--jobs", type=int, default=1, help="number of faults tried at the same time"
    )
    parser.add_argument(
        "--limit", type=float, default=300.0, help="time limit for the tests of a fault [s]"
    )
    parser.add_argument("--out", type=Path, help="write the results to this JSON file")
    parser.add_argument("--record", action="store_true", help="write `caught_by` to faults.yaml")
    parser.add_argument(
        "--check", action="store_true", help="only check that each fault can be applied to the code"
    )
    arguments = parser.parse_args()
    console, faults = Console(), read_faults()
    chosen = [
        fault
        for fault in faults
        if fault.id in (arguments.ids or [fault.id])
        and fault.area == (arguments.area or fault.area)
    ]
    unknown = sorted(set(arguments.ids) - {fault.id for fault in faults})
    errors = [
        *problems(faults),
        *(
            f"{one}: no fault has this id; see lab/cairn_lab/mutation/faults.yaml"
            for one in unknown
        ),
    ]
    if errors or arguments.check:
        text = "\n".join(errors) or f"all {len(faults)} faults can be applied"
        console.print(text, markup=False)
        return 1 if errors else 0
    results: list[Result] = []
    for result in _judge_all(chosen, arguments.jobs, arguments.limit):
        results.append(result)
        note = (
            f"; {result.unreliable} does not count: it failed only once, or fails without the fault"
            if result.unreliable
            else ""
        )
        text = f"{result.id}: {result.caught_by} ({result.seconds} s){note}"
        console.print(text, soft_wrap=True, markup=False)
        if arguments.out is not None:
            arguments.out.write_text(
                json.dumps([asdict(one) for one in results], indent=1), "utf-8"
            )
        if arguments.record:
            found = {one.id: one.caught_by for one in results}
            update = [{"caught_by": found.get(fault.id, fault.caught_by)} for fault in faults]
            write_faults([f.model_copy(update=u) for f, u in zip(faults, update, strict=True)])
    table = Table("fault", "result", Column("first failing test", overflow="fold"), "seconds")
    for one in results:
        caught = "caught" if one.caught else "MISSED"
        table.add_row(one.id, caught, one.caught_by, f"{one.seconds:.1f}")
    console.print(table)
    return 0 if all(one.caught for one in results) else 1


if __name__ == "__main__":
    sys.exit(main())
