"""Runs of an experiment, several at a time, in lockstep, each with its series and its log."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from cairn import CairnError
from cairn.cli.runs import log_file, worker_pool
from cairn.placement.lockstep import LockstepRun
from cairn.tools.experiments.pairs import Plan, planned


@dataclass(frozen=True)
class Job:
    """One run: what, with which seed, and the folder of its series and its log.

    `moves`: something is to be moved in it.
    """

    plan: Plan
    seed: int
    folder: Path
    moves: bool

    def called(self, whole: Path) -> str:
        """Its name among those of an experiment whose folder is `whole`."""
        return str(self.folder.relative_to(whole))


def checked(plan: Plan) -> None:
    """See that a plan can be run before many runs of it; `CairnError` says why not."""
    with TemporaryDirectory(prefix="cairn-experiment-") as scratch:
        planned(plan, Path(scratch), Path(scratch))


def run_all(jobs: Sequence[Job], workers: int, tell: Callable[[Job, str], None]) -> list[str]:
    """Run them, and give why each failed, "" if it did not; `tell` is told of each at its end."""
    failures = [""] * len(jobs)
    count = min(workers or os.cpu_count() or 1, len(jobs))
    with worker_pool(count) as pool:
        begun = {pool.submit(run, job): number for number, job in enumerate(jobs)}
        for future in as_completed(begun):
            number = begun[future]
            try:
                failures[number] = future.result()
            except Exception as error:  # whatever it is, the other runs are not to be lost
                failures[number] = str(error) if isinstance(error, CairnError) else repr(error)
            tell(jobs[number], failures[number])
    return failures


def run(job: Job) -> str:
    """Run one; gives why the robot did not do what was asked of it, "" if it did.

    `CairnError` if the deployment fails.
    """
    job.folder.mkdir(parents=True, exist_ok=True)
    logging.getLogger("cairn").propagate = False  # a run's failures are in its log and its result
    with TemporaryDirectory(prefix="cairn-experiment-") as scratch:
        lockstep = LockstepRun(planned(job.plan, job.folder, Path(scratch)), job.seed)
        with log_file(job.folder / "log.txt", lockstep.executor.now):
            end = lockstep.run(lambda: None)
    if not end.normal:
        raise CairnError(end.reason)
    return "" if end.success else end.reason
