"""Runs the deployment of a benchmark as a user does, with `cairn up`."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml


def run_deployment(
    components: Mapping[str, Any], limit_s: float, *arguments: str, clock: str = "system"
) -> str:
    """Run these components to their end with `cairn up` and return its output.

    Raises `RuntimeError` with the output if it fails or takes longer than `limit_s`.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "bench.yaml"
        file.write_text(
            yaml.safe_dump(
                {
                    "cairn": 1,
                    "robot": "bench",
                    "clock": clock,
                    "bus": {"socket": f"{folder}/bus.sock"},
                    "components": dict(components),
                },
                sort_keys=False,
            )
        )
        command = [sys.executable, "-m", "cairn.cli.program", "up", str(file)]
        command += ["--report", str(Path(folder) / "run"), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)} failed:\n{done.stdout}\n{done.stderr}")
    return done.stdout


def results(output: str) -> list[dict[str, Any]]:
    """Return the results that the components of a benchmark logged as `RESULT {json}`."""
    return [
        json.loads(line.partition("RESULT ")[2])
        for line in output.splitlines()
        if "RESULT " in line
    ]
