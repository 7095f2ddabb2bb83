"""The options of commands that run batches: which seeds, where, and with which cache."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import typer

from cairn.errors import CairnError
from cairn.system.user_folders import cache_folder
from cairn_lab.batch.cache import ResultCache
from cairn_lab.batch.workers import LocalWorkers, Workers

WorkerCount = Annotated[
    int, typer.Option(min=0, help="Number of parallel runs; 0: one per processor.")
]
On = Annotated[
    str,
    typer.Option(
        "--on",
        help="Run on the workers of a Dask cluster, by the address of its scheduler.",
        metavar="dask://HOST:PORT",
        show_default="this computer",
    ),
]
CacheFolder = Annotated[
    Path | None,
    typer.Option(
        "--cache",
        help="Folder in which the results of runs are kept: equal runs are not made again.",
        metavar="FOLDER",
        show_default="`cairn/runs` in the user's cache folder",
    ),
]
NoCache = Annotated[
    bool, typer.Option("--no-cache", help="Make all runs again, and keep no results.")
]


@dataclass(frozen=True)
class BatchOptions:
    """Where tasks run, by `--workers` or `--on`, and where their results are kept."""

    workers: int = 0
    on: str = ""
    cache: Path | None = None
    no_cache: bool = False

    def __post_init__(self) -> None:
        """Raise `CairnError` if the options exclude each other, or `on` cannot be used."""
        if self.cache is not None and self.no_cache:
            raise CairnError("--cache and --no-cache exclude each other; give one of them")
        if not self.on:
            return
        _scheduler(self.on)
        if self.workers:
            raise CairnError(
                "--workers is the number of processes of this computer; with --on, start as many "
                "workers as you want there, and leave it out"
            )
        if find_spec("distributed") is None:
            raise CairnError(
                f"--on {self.on}: Dask is not installed; install it with this extra: pip install "
                "'cairn-lab[dask]'"
            )

    def open_cache(self) -> ResultCache | None:
        """Return the cache; None if there is to be none."""
        if self.no_cache:
            return None
        return ResultCache(self.cache or cache_folder("cairn") / "runs")

    def open_workers(self, tasks: int) -> Workers:
        """Return the workers for so many tasks."""
        if not self.on:
            return LocalWorkers(max(1, min(self.workers or os.cpu_count() or 1, tasks)))
        from cairn_lab.batch.dask_workers import DaskWorkers  # needs the extra `dask`

        return DaskWorkers(_scheduler(self.on))


def _scheduler(on: str) -> str:
    """Return the address of a scheduler as Dask writes it; `CairnError` if it is invalid."""
    try:
        parts = urlsplit(on)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host is None or port is None or on != f"dask://{parts.netloc}":
        raise CairnError(f"--on {on}: write it as dask://HOST:PORT, such as dask://127.0.0.1:8786")
    return f"tcp://{parts.netloc}"


def seeds_of(text: str) -> range:
    """Return the seeds of `--seeds A..B`, or of one number; `CairnError` if it is invalid."""
    first, dots, last = text.partition("..")
    try:
        begin = int(first)
        end = int(last) if dots else begin
    except ValueError:
        raise CairnError(f"--seeds {text}: write it as A..B, such as 0..19") from None
    if not 0 <= begin <= end:
        raise CairnError(f"--seeds {text}: A must not be negative nor larger than B")
    return range(begin, end + 1)
