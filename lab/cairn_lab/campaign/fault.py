"""What a kind of fault is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import AbstractContextManager
from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING, ClassVar, Final

from cairn.errors import CairnError
from cairn.runtime.parameters import Config
from cairn_lab.campaign.entry_points import KindGroup

if TYPE_CHECKING:
    from cairn_lab.campaign.robot import CampaignRobot


class SkippedFault(CairnError):
    """A fault cannot be injected now, for example because its target does not run."""


@dataclass
class Injection:
    """A fault that was injected: its target, what was done to it, and for how long [s].

    0: nothing has to be undone. `effect` may be changed until the end.
    """

    target: str
    effect: str
    lasts_s: float = 0.0


class Fault(ABC):
    """A kind of fault; derive from it to add one.

    `config_type` declares its parameters.
    """

    config_type: ClassVar[type[Config]] = Config

    ends_deployment: ClassVar[bool] = False
    """Whether the fault ends `cairn up`, by design; the campaign then launches it again."""

    needs_clocks: ClassVar[bool] = False
    """Whether the deployment needs clocks of its own, `robot.clocks`, which the fault steps."""

    def __init__(self, config: Config) -> None:
        """Take the parameters, an instance of `config_type`."""
        self.config = config

    @abstractmethod
    def inject(self, robot: CampaignRobot, random: Random) -> AbstractContextManager[Injection]:
        """Return a context: entering it injects the fault, leaving it undoes the fault.

        The campaign leaves the context when the fault's time is over, when the deployment has
        ended, and at its own end. Neither may take longer than a second. All that is random is
        drawn from `random`. Raises `SkippedFault` if it cannot be injected now.
        """


FAULTS: Final = KindGroup("cairn.faults", "fault", Fault)  # type: ignore[type-abstract]
