"""The folder of an experiment's report, which never mixes files of two reports."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from cairn import CairnError
from cairn.cli.run_folders import writing_report
from cairn.limits.files import STATE_BYTES, read_bounded
from cairn.system.files import replace_file
from cairn.terminal.output import note

_FIGURES, _TEXT, _RUNS = "report.json", "report.txt", "runs"
_LISTED = 3  # files of a refused folder that the error lists


@dataclass(frozen=True)
class ReportFolder:
    """The folder of a report; `pictures` are the names of the pictures that it may have."""

    path: Path
    experiment: str
    pictures: tuple[str, ...]

    def run(self, seed: int, *parts: str) -> Path:
        """Return the folder of a run."""
        return self.path.joinpath(_RUNS, f"seed-{seed}", *parts)


@contextmanager
def open_report(folder: ReportFolder) -> Iterator[None]:
    """Create the folder, or remove an earlier report of the same experiment from it.

    Raises `CairnError` if it holds anything else, if another process is writing a report into it,
    or if it cannot be written. Until the report is written, report.json has `"finished": false`.
    """
    out = folder.path
    with writing_report(out):
        out.mkdir(parents=True, exist_ok=True)
        opened = os.open(out, os.O_RDONLY)
    try:
        _lock(out, opened)
        _clear(folder)
        yield
    finally:
        os.close(opened)


def write_report(
    folder: ReportFolder,
    lines: Sequence[str],
    body: Mapping[str, Any],
    models: Sequence[type[BaseModel]],
    pictures: Mapping[str, Callable[[Path], None]],
) -> None:
    """Write the pictures, report.txt, and report.json with the descriptions of the fields."""
    about = {model.__name__: _descriptions(model) for model in models}
    with writing_report(folder.path):
        for name, draw in pictures.items():
            draw(folder.path / name)
        (folder.path / _TEXT).write_text("\n".join(lines) + "\n", encoding="utf-8")
        _write_figures(folder, {"finished": True, **body, "about": about})


def _lock(out: Path, opened: int) -> None:
    """Lock the folder until `opened` is closed, at the latest when this process ends."""
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise CairnError(
            f"{out}: another experiment is writing its report into this folder; wait until it has "
            "finished, or name another folder with --out"
        ) from None


def _clear(folder: ReportFolder) -> None:
    out = folder.path
    with writing_report(out):
        names = sorted(one.name for one in out.iterdir())
        if names:
            _check_is_replaceable(folder, names)
            note(f"{out}: the earlier report is replaced")
        # First: if the rest fails, the folder does not look like a complete report.
        _write_figures(folder, {"finished": False})
        if (out / _RUNS).exists():
            shutil.rmtree(out / _RUNS)
        for name in (_TEXT, *folder.pictures):
            (out / name).unlink(missing_ok=True)


def _check_is_replaceable(folder: ReportFolder, names: Sequence[str]) -> None:
    earlier = _experiment_of(folder.path / _FIGURES)
    if earlier == folder.experiment:
        return
    if earlier is None:
        listed = ", ".join([*names[:_LISTED], *(["..."] if len(names) > _LISTED else [])])
        content = f"holds {listed} and no report of this command"
    else:
        content = f"holds a report of cairn experiment {earlier}"
    raise CairnError(
        f"{folder.path}: this folder {content}, which is not overwritten; name a new folder with "
        "--out, or empty this one"
    )


def _experiment_of(file: Path) -> str | None:
    """Return the experiment of a report, finished or not; None if the file is not a report."""
    try:
        report = json.loads(read_bounded(file, STATE_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    experiment = report.get("experiment") if isinstance(report, dict) else None
    return experiment if isinstance(experiment, str) else None


def _write_figures(folder: ReportFolder, body: Mapping[str, Any]) -> None:
    text = json.dumps({"experiment": folder.experiment, **body}, indent=1, allow_nan=False)
    replace_file(folder.path / _FIGURES, text.encode() + b"\n")


def _descriptions(model: type[BaseModel]) -> dict[str, str]:
    fields = model.model_fields.items()
    return {name: field.description for name, field in fields if field.description}
