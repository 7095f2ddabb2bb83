"""Sweeps of which `make test` runs a sample, and `make accuracy` the rest."""

from collections.abc import Iterable
from typing import Any

import pytest


def sampled(cases: Iterable[Any], kept: int = 1) -> list[Any]:
    """Return the cases of `parametrize`, of which those after the first `kept` are of `accuracy`.

    A case of several arguments is a tuple.
    """
    every = list(cases)
    rest = [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.accuracy)
        for case in every[kept:]
    ]
    return [*every[:kept], *rest]
