"""What all experiments do alike: run, read again what was written down, and leave a report."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from cairn.cli.tables import note
from cairn.errors import CairnError
from components.experiments.judging import RunResult, judged_pair, judged_world
from components.experiments.pairs import WORLD, series_file
from components.experiments.runs import Job, checked, run_all
from components.experiments.series import PairSeries, WorldSeries, read_pair, read_world


@dataclass(frozen=True)
class Observed:
    """A run that was done: what was true, what each pair told by its method, and the judgement."""

    job: Job
    world: WorldSeries
    pairs: Mapping[str, PairSeries]
    result: RunResult


def observed(
    jobs: Sequence[Job], out: Path, workers: int, changed_at: float, *, quiet: bool
) -> tuple[list[Observed], dict[str, str]]:
    """Run all and read what was written down; and why runs failed, by their names.

    A run that failed counts for nothing. `CairnError` if none can be run.
    """
    checked(jobs[0].plan)
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    done = 0

    def tell(job: Job, failure: str) -> None:
        nonlocal done
        done += 1
        if not quiet:
            what = f"failed: {failure}" if failure else "done"
            note(f"{done} of {len(jobs)}: {job.called(out)} {what}")

    failures = run_all(jobs, workers, tell)
    runs: list[Observed] = []
    failed: dict[str, str] = {}
    for job, failure in zip(jobs, failures, strict=True):
        if failure:
            failed[job.called(out)] = failure
            continue
        run = _read(job, changed_at)
        if run.result.sightings:
            runs.append(run)
        else:
            failed[job.called(out)] = (
                "no object was recognised in all of the run; if it is from pixels, see that the "
                "visual map holds the objects' pictures (cairn object list): `cairn map import "
                "world` makes one that does, for --set visual_map=FILE"
            )
    return runs, failed


def _read(job: Job, changed_at: float) -> Observed:
    world = read_world(series_file(job.folder, WORLD))
    pairs = {m.name: read_pair(series_file(job.folder, m.name)) for m in job.plan.methods}
    result = judged_world(job.seed, world, changed_at)
    judged = [judged_pair(name, pair, world, changed_at) for name, pair in pairs.items()]
    return Observed(job, world, pairs, result.model_copy(update={"pairs": judged}))


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Tell what keeps the report from being written."""
    try:
        yield
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        raise CairnError(
            f"the report's folder {out} cannot be written: {where}{error.strerror or error}; name "
            "another one with --out, or make room there"
        ) from error


def write_report(
    out: Path,
    lines: Sequence[str],
    body: Mapping[str, Any],
    models: Sequence[type[BaseModel]],
    pictures: Mapping[str, Callable[[Path], None]],
) -> None:
    """Write report.txt, report.json, with what the fields of its `models` mean, and pictures."""
    about = {model.__name__: _described(model) for model in models}
    with writing(out):
        for name, draw in pictures.items():
            draw(out / name)
        (out / "report.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
        text = json.dumps({**body, "about": about}, indent=1, allow_nan=False)
        (out / "report.json").write_text(text + "\n", encoding="utf-8")


def _described(model: type[BaseModel]) -> dict[str, str]:
    fields = model.model_fields.items()
    return {name: field.description for name, field in fields if field.description}
