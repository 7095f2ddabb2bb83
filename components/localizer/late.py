"""Sightings that come late: what was seen then, as it would be seen from where the robot is now."""

from __future__ import annotations

import math
from dataclasses import replace

from cairn.components.localizer.absence import View
from cairn.components.localizer.object_likelihood import Sighting
from cairn.planar.poses import Pose, wrap


def seen_from(sighting: Sighting, step: Pose) -> Sighting:
    """A sighting as from the pose that lies at `step` [m, rad] from where it was made."""
    x, y, turn = step
    dx = sighting.range_m * math.cos(sighting.bearing) - x
    dy = sighting.range_m * math.sin(sighting.bearing) - y
    range_m = max(math.hypot(dx, dy), 0.05)
    return replace(sighting, range_m=range_m, bearing=wrap(math.atan2(dy, dx) - turn))


def view_from(view: View, step: Pose) -> View:
    """A camera's view likewise; in the moment that a sighting is late a robot comes hardly on."""
    return replace(view, right=view.right - step[2], left=view.left - step[2])
