"""Zones of the map as cells of a grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cairn.planar.grid import Frame
from cairn.planar.polygons import covered_cells
from cairn.planar.zone_cells import keepout_cells, part_of, window_of
from cairn.planar.zones import zone_edges, zone_of
from cairn.schemas.cairn_nav_msgs import Zone

SHAPE = (40, 60)


def area(kind: str, corners: list[tuple[float, float]]) -> Zone:
    speed = {"speed": 0.2} if kind == "slow" else {}
    properties = {"zone": kind, "name": kind, **speed}
    geometry = {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}
    return zone_of({"type": "Feature", "properties": properties, "geometry": geometry})


TRIANGLE = area("keepout", [(0.51, 0.32), (1.93, 0.41), (1.02, 1.53)])
BEYOND = area("keepout", [(2.52, 1.51), (9.0, 1.53), (9.0, 9.0)])
SLOW = area("slow", [(0.1, 0.1), (2.0, 0.1), (2.0, 1.0)])


@pytest.mark.parametrize("angle", [0.0, 0.7, math.pi])
def test_keepout_cells_are_those_that_a_keepout_zone_touches(angle: float) -> None:
    frame = Frame(0.05, (0.2, -0.1, angle))
    expected = np.zeros(SHAPE, np.bool_)
    for zone in (TRIANGLE, BEYOND):
        expected |= covered_cells(zone_edges(zone), frame, SHAPE)
    cells = keepout_cells([TRIANGLE, SLOW, BEYOND], frame, SHAPE)
    assert cells is not None
    np.testing.assert_array_equal(cells, expected)


def test_without_keepout_zones_there_are_no_cells() -> None:
    assert keepout_cells([SLOW], Frame(0.05), SHAPE) is None


def test_zone_outside_of_the_grid_has_no_window() -> None:
    frame = Frame(0.05, (-100.0, 0.0, 0.0))
    assert window_of([TRIANGLE], frame, SHAPE) is None
    cells = keepout_cells([TRIANGLE], frame, SHAPE)
    assert cells is not None
    assert not cells.any()


def test_part_of_a_grid_has_the_same_cells() -> None:
    frame = Frame(0.05, (0.2, -0.1, 0.7))
    part, shape = part_of(frame, (slice(7, 20), slice(11, 30)))
    assert shape == (13, 19)
    assert part.point(2, 3) == pytest.approx(frame.point(9, 14))
