"""Runs `cairn` commands in the process of the tests, as the script does in one of its own."""

import io
import json
import logging
import math
import os
import sys
import time
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

from cairn.cli.main import main
from tests.patience import LIMIT_S


@dataclass(frozen=True)
class Answer:
    """The exit code of a command, and what it printed."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Its output as JSON."""
        return json.loads(self.out)


def cairn(*arguments: str, connect: str = "") -> Answer:
    """Run a command; `connect` is the endpoint that the environment names."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    with (
        patch.object(sys, "argv", ["cairn", *arguments]),
        patch.dict(os.environ, {"CAIRN_CONNECT": connect} if connect else {}),
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as end:
            code = end.code
        finally:
            logging.captureWarnings(False)
    return Answer(int(str(code or 0)), out.getvalue(), err.getvalue())


def await_answer(ask: Callable[[], Answer], accept: Callable[[Answer], bool]) -> Answer:
    """Return the first answer for which `accept` holds: a busy computer may not answer in time."""
    deadline = time.monotonic() + LIMIT_S
    while not accept(answer := ask()):
        assert time.monotonic() < deadline, f"not accepted within {LIMIT_S:g} s: {answer}"
    return answer


def quick_answer(ask: Callable[[], Answer], limit_s: float) -> Answer:
    """Return the first answer that takes less than this time: a busy computer may be slow."""
    took_s = math.inf

    def timed() -> Answer:
        nonlocal took_s
        began = time.monotonic()
        answer = ask()
        took_s = time.monotonic() - began
        return answer

    return await_answer(timed, lambda _: took_s < limit_s)


def all_answered(answer: Answer) -> bool:
    """Return whether all components answered `cairn ps` in time."""
    return answer.code == 0 and "no answer" not in answer.out


def await_status(
    component: str, accept: Callable[[dict[str, Any]], bool], connect: str
) -> dict[str, Any]:
    """Return a component's row of `cairn ps` once `accept` holds: heartbeats follow events."""

    def row_in(answer: Answer) -> dict[str, Any]:
        rows = answer.json if answer.code == 0 else []
        return next((row for row in rows if row["component"] == component), {})

    def is_accepted(answer: Answer) -> bool:
        row = row_in(answer)
        return bool(row) and accept(row)

    return row_in(await_answer(lambda: cairn("ps", "--json", connect=connect), is_accepted))
