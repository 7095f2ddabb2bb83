"""The `cairn` program, which restarts itself before it imports anything for `cairn up`."""

import sys
from typing import NoReturn

from cairn.system.heap import restart_with_small_thread_caches


def script() -> NoReturn:
    """Run the command and end the process."""
    if sys.argv[1:2] == ["up"]:  # it runs for months, others for seconds
        restart_with_small_thread_caches()
    from cairn.cli.main import main
    from cairn.runtime.process_exit import end_process

    try:
        main()
    except SystemExit as end:
        end_process(end.code if isinstance(end.code, int) else int(end.code is not None))
    end_process(0)


if __name__ == "__main__":
    script()
