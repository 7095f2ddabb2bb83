"""Re-runs one start of a component in a process of its own: a crash or a hang ends only that."""

import json
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from cairn.errors import CairnError
from cairn.recording.reader import McapRecording
from cairn.rerun.call_logs import ComponentStart
from cairn.rerun.engine import RerunResult
from cairn.rerun.run import prepared_rerun, starts_in

_RESULT = TypeAdapter(RerunResult)
_SHOWN_LOG: Final = 2000  # bytes


def rerun_in_process(
    files: Sequence[Path],
    start: ComponentStart,
    until_ns: int | None,
    time_limit_s: float,
) -> RerunResult:
    """Return the result of a re-run that a new process makes.

    A crash, a hang and an error are in `incomplete`.
    """
    result = RerunResult(start.component, start.incarnation)
    with tempfile.TemporaryDirectory(prefix="cairn-rerun-") as folder:
        answer, log = Path(folder, "result.json"), Path(folder, "log")
        request = {
            "files": [str(file.absolute()) for file in files],
            "component": start.component,
            "incarnation": start.incarnation,
            "started_ns": start.started_ns,
            "until_ns": until_ns,
            "answer": str(answer),
        }
        with log.open("wb") as stream:
            process = subprocess.Popen(
                [sys.executable, "-m", "cairn.rerun.worker"],
                stdin=subprocess.PIPE, stdout=stream, stderr=stream, start_new_session=True,
                env={**os.environ, "PYTHONFAULTHANDLER": "1"},
            )  # fmt: skip
            try:
                process.communicate(json.dumps(request).encode(), time_limit_s)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                result.incomplete = (
                    f"the re-run took longer than {time_limit_s:g} s; give a longer --time-limit, "
                    "or see whether a handler hangs"
                )
                return result
        try:
            return _RESULT.validate_json(answer.read_bytes())
        except (OSError, ValidationError):
            end = log.read_bytes()[-_SHOWN_LOG:].decode(errors="replace").strip()
            result.incomplete = f"its process ended with status {process.returncode}: {end}"
            return result


def main() -> None:
    """Make the re-run that stdin describes, and write its result to a file."""
    logging.basicConfig(level=logging.ERROR)
    request: dict[str, Any] = json.load(sys.stdin)
    name, incarnation = request["component"], request["incarnation"]
    result = RerunResult(name, incarnation)
    try:
        with McapRecording([Path(file) for file in request["files"]]) as recording:
            start = next(
                one
                for one in starts_in(recording)
                if (one.component, one.incarnation, one.started_ns)
                == (name, incarnation, request["started_ns"])
            )
            with prepared_rerun(recording, start, request["until_ns"]) as rerun:
                result = rerun.run()
    except CairnError as error:
        result.incomplete = str(error)
    Path(request["answer"]).write_text(json.dumps(asdict(result)))


if __name__ == "__main__":
    main()
