"""Tasks that take milliseconds: a deployment with one component, which writes random numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cairn.deployment.load import load_deployment
from cairn_lab.batch.packing import pack_deployment
from cairn_lab.batch.task import Task

OUTPUT = "numbers.txt"
_DEPLOYMENT = """\
cairn: 1
settings: {report: "."}
components:
  clerk:
    plugin: cairn_test_plugins.clerk:Clerk
    parameters: {file: "${report}/numbers.txt", source: "${here}/source.txt"}
    restart: transient
    significant: true
"""


def clerk_tasks(folder: Path, seeds: Sequence[int], *sets: str) -> list[Task]:
    """A task for each seed, from files in a folder."""
    folder.mkdir(exist_ok=True)
    (folder / "source.txt").write_text("begin\n")
    file = folder / "clerk.yaml"
    file.write_text(_DEPLOYMENT)
    report = folder / "report"
    changes = [f"components.clerk.parameters.{one}" for one in sets]
    packed = pack_deployment(
        load_deployment(file, (), [f"settings.report={report}", *changes]), report
    )
    return [Task(f"seed {seed}", packed, seed, (OUTPUT,)) for seed in seeds]
