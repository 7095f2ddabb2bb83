"""A command that is killed leaves no worker process."""

import os
import select
import subprocess
import sys
from pathlib import Path

import pytest

from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


COMMAND = """
import os, threading
from cairn_lab.batch.worker_pool import worker_pool

def hang():
    os.write(1, f"{os.getpid()}\\n".encode())  # whole: print may write the number and its end
    threading.Event().wait(60)

if __name__ == "__main__":
    with worker_pool(2) as pool:
        for future in [pool.submit(hang) for _ in range(2)]:
            future.result()
"""


def test_workers_end_with_the_command_that_is_killed(tmp_path: Path) -> None:
    script = tmp_path / "command.py"
    script.write_text(COMMAND)
    root = str(Path(__file__).parents[3])
    with subprocess.Popen(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": root},
        stdout=subprocess.PIPE,
        text=True,
    ) as command:
        assert command.stdout is not None
        workers = [os.pidfd_open(int(command.stdout.readline())) for _ in range(2)]

        command.kill()

        for worker in workers:
            ended, _, _ = select.select([worker], [], [], LIMIT_S)
            os.close(worker)
            assert ended
