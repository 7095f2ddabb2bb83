"""Steps of the clock of a machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from random import Random
from typing import Annotated

from pydantic import Field

from cairn_lab.campaign.fault import Fault, Injection, SkippedFault
from cairn_lab.campaign.parameters import Duration, Patterns, matching
from cairn_lab.campaign.robot import CampaignRobot

_LONGEST_S = 10 * 365 * 86_400.0

StepS = Annotated[float, Field(ge=-_LONGEST_S, le=_LONGEST_S)]


class ClockStepConfig(Duration):
    """Parameters of `clock_step`."""

    steps_s: tuple[StepS, ...] = Field(
        (0.5, -0.5, 3600.0, -3600.0),
        min_length=1,
        max_length=100,
        description="Steps of which one is drawn [s]; negative: back.",
    )
    machines: Patterns = Field(
        ("*",), description="Names of machines that may be drawn, as patterns."
    )


class ClockStep(Fault):
    """Step the clock of a machine, and later by as much in the other direction."""

    config_type = ClockStepConfig
    config: ClockStepConfig
    needs_clocks = True

    @contextmanager
    def inject(self, robot: CampaignRobot, random: Random) -> Iterator[Injection]:
        """Step it for all processes of the machine at once."""
        lasts_s = self.config.draw(random)
        step_s = random.choice(self.config.steps_s)
        machines = matching(robot.machines, self.config.machines)
        if not machines:
            raise SkippedFault(
                f"no machine matches {', '.join(self.config.machines)}; the deployment's: "
                f"{', '.join(robot.machines)}"
            )
        machine = random.choice(machines)
        with robot.clocks.stepped(machine, step_s):
            effect = f"clock stepped by {step_s:+g} s for {lasts_s:g} s"
            yield Injection(robot.roots[machine], effect, lasts_s)
