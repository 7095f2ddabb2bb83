"""The pictures of an evaluation show what was measured, and nothing else."""

import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from cairn.planar.grid import Frame, Grid
from cairn.tools.evaluation.pictures import draw_tracks, draw_ways
from cairn.tools.evaluation.results import RunResult


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are saved."""
    figures: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: figures.append(self))
    return figures


def test_a_run_without_poses_has_no_error_in_the_picture(drawn: list[Figure]) -> None:
    runs = [RunResult(seed=0, error_median=0.01, error_p95=0.02), RunResult(seed=1, failure="dead")]

    draw_ways(runs, Path("ways.png"))

    _, errors = drawn[0].axes
    for line, error in zip(errors.lines, (0.01, 0.02), strict=True):
        first, second = np.asarray(line.get_ydata(), float)
        assert first == error
        assert math.isnan(second)


def test_no_way_is_drawn_where_the_robot_was_carried(drawn: list[Figure]) -> None:
    run = RunResult(seed=0, track=[(0.1, 0.1), (0.2, 0.1), (2.0, 2.0), (2.1, 2.0)])

    draw_tracks(Grid(np.zeros((50, 50), np.int8), Frame(0.05)), [run], Path("tracks.png"))

    x = np.asarray(drawn[0].axes[0].lines[0].get_xdata(), float)
    assert np.isnan(x).tolist() == [False, False, True, False, False]
