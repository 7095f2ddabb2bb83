"""The folder of an experiment's report: what is in it is of one report, and of no other."""

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
from cairn.cli.output import note
from cairn.cli.runs import writing_report
from cairn.files import replace_file

_FIGURES, _TEXT, _RUNS = "report.json", "report.txt", "runs"
_NAMED = 3  # of what is in a folder, in an error


@dataclass(frozen=True)
class ReportFolder:
    """Where the report of an experiment goes; `pictures` are the names of those it may have."""

    path: Path
    experiment: str
    pictures: tuple[str, ...]

    def run(self, seed: int, *parts: str) -> Path:
        """The folder of a run."""
        return self.path.joinpath(_RUNS, f"seed-{seed}", *parts)


@contextmanager
def begun(folder: ReportFolder) -> Iterator[None]:
    """Make the folder, or take an earlier report of the same experiment out of it.

    `CairnError` if it holds anything else, if another process writes a report into it now, or if it
    cannot be written. Until the report is written, report.json says that it is not finished.
    """
    out = folder.path
    with writing_report(out):
        out.mkdir(parents=True, exist_ok=True)
        opened = os.open(out, os.O_RDONLY)
    try:
        _hold(out, opened)
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
    """Write report.txt, report.json, with what the fields of its `models` mean, and pictures."""
    about = {model.__name__: _described(model) for model in models}
    with writing_report(folder.path):
        for name, draw in pictures.items():
            draw(folder.path / name)
        (folder.path / _TEXT).write_text("\n".join(lines) + "\n", encoding="utf-8")
        _write_figures(folder, {"finished": True, **body, "about": about})


def _hold(out: Path, opened: int) -> None:
    """Keep others out as long as the folder is `opened`; whatever ends this process ends that."""
    try:
        fcntl.flock(opened, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise CairnError(
            f"another experiment writes its report into {out} just now: wait for its end, or name "
            "another folder with --out"
        ) from None


def _clear(folder: ReportFolder) -> None:
    out = folder.path
    with writing_report(out):
        held = sorted(one.name for one in out.iterdir())
        if held:
            _refuse_others(folder, held)
            note(f"{out}: the earlier report is replaced")
        # First of all: whatever becomes of the rest, nobody takes it for a whole report.
        _write_figures(folder, {"finished": False})
        if (out / _RUNS).exists():
            shutil.rmtree(out / _RUNS)
        for name in (_TEXT, *folder.pictures):
            (out / name).unlink(missing_ok=True)


def _refuse_others(folder: ReportFolder, held: Sequence[str]) -> None:
    earlier = _experiment_of(folder.path / _FIGURES)
    if earlier == folder.experiment:
        return
    if earlier is None:
        named = ", ".join([*held[:_NAMED], *(["..."] if len(held) > _NAMED else [])])
        what = f"holds {named} and no report of this command"
    else:
        what = f"holds a report of cairn experiment {earlier}"
    raise CairnError(
        f"the report's folder {folder.path} {what}, which is not overwritten: name a new folder "
        "with --out, or empty this one"
    )


def _experiment_of(file: Path) -> str | None:
    """Of which experiment a report is, finished or not; None if it is not one."""
    try:
        report = json.loads(file.read_bytes())
    except (FileNotFoundError, ValueError):
        return None
    experiment = report.get("experiment") if isinstance(report, dict) else None
    return experiment if isinstance(experiment, str) else None


def _write_figures(folder: ReportFolder, body: Mapping[str, Any]) -> None:
    text = json.dumps({"experiment": folder.experiment, **body}, indent=1, allow_nan=False)
    replace_file(folder.path / _FIGURES, text.encode() + b"\n")


def _described(model: type[BaseModel]) -> dict[str, str]:
    fields = model.model_fields.items()
    return {name: field.description for name, field in fields if field.description}
