"""Views of submaps: what moved is left out; what another one sees through is in conflict."""

import math

import numpy as np

from cairn.components.slam.keyframes import Keyframe, Submap, scan_cloud, scan_rays, scan_surfaces
from cairn.components.slam.submap_view import SubmapView, conflicts, view_of
from cairn.planar.scans import Rays

ANGLES = np.radians(np.arange(-90.0, 90.5, 0.5))
STILL = (0.0, 0.0, 0.0)


def view(walls: list[float], person: float | None = None) -> SubmapView:
    """What scans show of a wall across the x axis at each distance, one after the other."""
    frames = []
    for number, x in enumerate(walls):
        with np.errstate(divide="ignore"):
            ranges = np.where(np.cos(ANGLES) > 0.3, x / np.cos(ANGLES), np.inf)
        if person is not None and number == 0:
            ranges[np.abs(ANGLES) < 0.1] = person
        rays = Rays(np.zeros((len(ANGLES), 2)), ANGLES, ranges, 20.0)
        surfaces = scan_surfaces(scan_cloud(rays, 20.0))
        frames.append(Keyframe(number, STILL, surfaces, scan_rays(rays), 0))
    return view_of(Submap(0, 0, len(walls) - 1), frames, np.zeros((len(walls), 3)))


def test_a_person_who_walked_on_is_not_part_of_the_view() -> None:
    seen = view([4.0] * 20, person=2.0)
    assert seen.surfaces.cloud().count > 50
    assert np.allclose(seen.surfaces.cloud().points[:, 0], 4.0, atol=0.05)
    assert math.isclose(
        view([4.0], person=2.0).surfaces.cloud().points[:, 0].min(), 2.0, abs_tol=0.05
    )


def test_points_in_free_space_are_in_conflict() -> None:
    far, near = view([6.0] * 4), view([3.0] * 4)
    middle = near.surfaces.cloud().points[np.abs(near.surfaces.cloud().points[:, 1]) < 3.0]
    assert conflicts(middle, [(STILL, far)]) > 0.9
    assert conflicts(far.surfaces.cloud().points, [(STILL, far)]) < 0.05
    assert conflicts(middle + np.array([100.0, 0.0]), [(STILL, far)]) == 0.0
