"""Faults in the simulated world: the robot is carried away, objects are swapped."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from random import Random
from typing import Any

from pydantic import Field

from cairn.errors import CairnError
from cairn.runtime.parameters import Config
from cairn_lab.campaign.fault import Fault, Injection, SkippedFault
from cairn_lab.campaign.free_space import free_space
from cairn_lab.campaign.robot import CampaignRobot

_WORLD = "simulated_world"
_REQUEST_S = 2.0
_TRIES = 5


class KidnapConfig(Config):
    """Parameters of `kidnap`."""

    clearance: float = Field(
        0.6, gt=0, le=10, description="Distance of the new place to what is not free [m]."
    )


class Kidnap(Fault):
    """Move the simulated robot to a random free place, without turning its wheels."""

    config_type = KidnapConfig
    config: KidnapConfig

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Move it; a place that the world refuses, because something is there, is drawn again."""
        try:
            space = free_space(robot.client, self.config.clearance)
        except CairnError as error:
            raise SkippedFault(f"no place to move the robot to: {error}") from error
        refused = ""
        for _ in range(_TRIES):
            x, y, theta = space.pose(random)
            try:
                request_world(robot, "kidnap", {"x": x, "y": y, "theta": theta})
            except CairnError as error:
                refused = str(error)
            else:
                yield Injection("world", f"moved the robot to {x:g}, {y:g}, {theta:g} rad")
                return
        raise SkippedFault(f"the world refuses to move the robot: {refused}")


class SwapObjects(Fault):
    """Exchange two objects of the simulated world, so that the visual map has to change."""

    config_type = Config

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Exchange them permanently."""
        try:
            rows = request_world(robot, "list", {})
            objects = sorted(
                (row for row in rows if row["kind"] == "object"), key=lambda row: row["name"]
            )
            if len(objects) < 2:
                raise SkippedFault("the world has no two objects")
            first, second = random.sample(objects, 2)
            for moved, to in ((first, second), (second, first)):
                pose = {key: to[key] for key in ("x", "y", "theta")}
                request_world(robot, "move", {"name": moved["name"], **pose})
        except CairnError as error:
            raise SkippedFault(f"the objects cannot be exchanged: {error}") from error
        yield Injection("world", f"exchanged {first['name']} and {second['name']}")


def request_world(robot: CampaignRobot, verb: str, arguments: dict[str, Any]) -> Any:
    """Return the reply of the simulated world to a request; raises `CairnError` without one."""
    worlds = [one.name for one in robot.deployment.members() if one.spec.plugin == _WORLD]
    if not worlds:
        raise SkippedFault(f"the deployment has no {_WORLD}; leave out this kind of fault")
    return robot.request(worlds[0], verb, arguments, _REQUEST_S)
