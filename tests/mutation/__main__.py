"""Applies deliberate faults to a copy of the code, and tells which of them the tests catch.

Each job works in a scratch folder of its own, with the files that git tracks. A fault is caught if
a test fails, fails again when it runs alone, and passes without the fault; or if the tests do not
end within the time limit, and pass within it without the fault. The exit status is 1 if a fault is
missed.
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
from queue import SimpleQueue
from uuid import uuid4

import psutil
from rich.console import Console
from rich.table import Column, Table

from tests.mutation.faults import NO_TEST, ROOT, Fault, mutated, problems, read_faults, write_faults

_MARK = "CAIRN_MUTATION"
_FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/.*?)(?:\[.*| - .*)?$", re.MULTILINE)
_PACKAGES = "cairn components planar schemas supervisors tests vision cairn_test_plugins"
# Where a child process finds the packages and what entry points name, whatever its folder is.
_WHENCE = f"""
import importlib.metadata, importlib.util
entries = importlib.metadata.distribution("cairn-robotics").entry_points
for module in [*"{_PACKAGES}".split(), *(entry.module for entry in entries)]:
    print(importlib.util.find_spec(module).origin)
"""


@dataclass(frozen=True)
class Result:
    """What the tests made of a fault; `caught_by` is a test, `timeout` or `none`.

    `unsound` is a test, or `timeout`, that fails without the fault as well, or only sometimes.
    """

    id: str
    room: str
    caught_by: str
    unsound: str
    seconds: float

    @property
    def caught(self) -> bool:
        """Whether the fault was noticed."""
        return self.caught_by != NO_TEST


class Scratch:
    """A copy of the code in which faults are applied and tests run."""

    def __init__(self, root: Path, limit_s: float) -> None:
        self.root = root
        self._limit_s = limit_s
        tracked = subprocess.run(
            ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True
        )
        for name in filter(None, tracked.stdout.decode().split("\0")):
            if os.path.lexists(ROOT / name):  # else it is deleted and not committed
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, root / name, follow_symlinks=False)
        shown = self._run([sys.executable, "-c", _WHENCE], tempfile.gettempdir(), root / ".numba")
        files = shown.split()
        if not files or not all(file.startswith(f"{root}{os.sep}") for file in files):
            raise SystemExit(f"{root}: child processes do not import this copy, but:\n{shown}")

    def judge(self, fault: Fault) -> Result:
        """Run the tests with the fault."""
        began = time.monotonic()
        with self._applied(fault) as cache:
            failed = self._failed(fault.tests, cache)
            suspects, unsound = fault.tests if failed == "timeout" else (failed,), ""
            # On a busy machine a test may fail for another reason: then it passes alone.
            once = failed not in (NO_TEST, "timeout") and self._failed(suspects, cache) == NO_TEST
        if failed != NO_TEST and (once or self._failed(suspects, self.root / ".numba") != NO_TEST):
            failed, unsound = NO_TEST, failed
        return Result(fault.id, fault.room, failed, unsound, round(time.monotonic() - began, 1))

    @contextmanager
    def _applied(self, fault: Fault) -> Iterator[Path]:
        """Apply a fault; gives the folder for compiled kernels to be used with it."""
        path, source = self.root / fault.file, (ROOT / fault.file).read_text("utf-8")
        # Numba does not notice that a kernel changed which another one calls.
        kernels = "@compiled" in source or "@numba" in source
        cache = Path(tempfile.mkdtemp(dir=self.root)) if kernels else self.root / ".numba"
        path.write_text(mutated(fault, source), "utf-8")
        try:
            yield cache
        finally:
            shutil.copy2(ROOT / fault.file, path)  # with its time, so that .pyc files are renewed

    def _failed(self, tests: Sequence[str], cache: Path) -> str:
        """Return the first test that fails, `timeout` or `none`."""
        pytest = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
        try:
            shown = self._run(pytest, str(self.root), cache)
        except subprocess.TimeoutExpired:
            return "timeout"
        found = _FAILED.search(shown)
        if found is None and not re.search(r"^\d+ (passed|skipped)", shown, re.MULTILINE):
            return tests[0]  # pytest itself did not come to an end
        return NO_TEST if found is None else found[1]

    def _run(self, command: Sequence[str], folder: str, cache: Path) -> str:
        """Return the output of a command; nothing that it started is left running."""
        mark = uuid4().hex
        imported = f"{self.root}{os.pathsep}{self.root / 'tests' / 'plugin_package'}"
        process = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, "PYTHONPATH": imported, "NUMBA_CACHE_DIR": str(cache), _MARK: mark},
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


def _judged(faults: Sequence[Fault], jobs: int, limit_s: float) -> Iterator[Result]:
    with (
        tempfile.TemporaryDirectory(prefix="mutation-") as folder,
        ThreadPoolExecutor(jobs) as pool,
    ):
        free: SimpleQueue[Scratch] = SimpleQueue()
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
    """Run the faults that were asked for."""
    parser = argparse.ArgumentParser("python -m tests.mutation", description=__doc__)
    parser.add_argument("ids", nargs="*", metavar="ID", help="faults to apply; by default all")
    parser.add_argument("--room", help="only the faults of this room")
    parser.add_argument("--jobs", type=int, default=1, help="how many faults to try at a time")
    parser.add_argument("--limit", type=float, default=300.0, help="for the tests of a fault [s]")
    parser.add_argument("--out", type=Path, help="write the results to this JSON file")
    parser.add_argument("--record", action="store_true", help="write caught_by to faults.yaml")
    parser.add_argument("--check", action="store_true", help="only check that faults apply")
    given = parser.parse_args()
    console, faults = Console(), read_faults()
    chosen = [
        fault
        for fault in faults
        if fault.id in (given.ids or [fault.id]) and fault.room == (given.room or fault.room)
    ]
    unknown = sorted(set(given.ids) - {fault.id for fault in faults})
    wrong = [*problems(faults), *(f"{one}: there is no fault with this id" for one in unknown)]
    if wrong or given.check:
        console.print("\n".join(wrong) or f"{len(faults)} faults apply", markup=False)
        return 1 if wrong else 0
    results: list[Result] = []
    for result in _judged(chosen, given.jobs, given.limit):
        results.append(result)
        why = (
            f"; {result.unsound} fails without the fault, too, or not always"
            if result.unsound
            else ""
        )
        told = f"{result.id}: {result.caught_by} ({result.seconds} s){why}"
        console.print(told, soft_wrap=True, markup=False)
        if given.out is not None:
            given.out.write_text(json.dumps([asdict(one) for one in results], indent=1), "utf-8")
        if given.record:
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
