"""The life cycle of a component, as in ROS 2 managed nodes, with its error transitions."""

import logging
from collections import deque
from enum import StrEnum

from cairn.clock import SECOND
from cairn.errors import CairnError

RECOVERIES = 3
RECOVERY_WINDOW_S = 10


class LifecycleState(StrEnum):
    """The primary states."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


class Transition(StrEnum):
    """What can be asked of a component."""

    CONFIGURE = "configure"
    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    CLEANUP = "cleanup"
    SHUTDOWN = "shutdown"


_GOAL = {
    (LifecycleState.UNCONFIGURED, Transition.CONFIGURE): LifecycleState.INACTIVE,
    (LifecycleState.INACTIVE, Transition.ACTIVATE): LifecycleState.ACTIVE,
    (LifecycleState.ACTIVE, Transition.DEACTIVATE): LifecycleState.INACTIVE,
    (LifecycleState.INACTIVE, Transition.CLEANUP): LifecycleState.UNCONFIGURED,
    (LifecycleState.UNCONFIGURED, Transition.SHUTDOWN): LifecycleState.FINALIZED,
    (LifecycleState.INACTIVE, Transition.SHUTDOWN): LifecycleState.FINALIZED,
    (LifecycleState.ACTIVE, Transition.SHUTDOWN): LifecycleState.FINALIZED,
}


def target_state(state: LifecycleState, transition: Transition) -> LifecycleState:
    """The state that a transition leads to if it succeeds.

    Raises `CairnError` if the transition does not begin in that state.
    """
    if (state, transition) not in _GOAL:
        possible = [other.value for begin, other in _GOAL if begin is state]
        raise CairnError(
            f"cannot {transition} in state {state}; possible are {', '.join(possible) or 'none'}"
        )
    return _GOAL[state, transition]


class RecoveryLimit:
    """Counts how often a component recovers from errors by itself: at most 3 times within 10 s."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=RECOVERIES)

    def admit(self, now: int, log: logging.Logger) -> bool:
        """Whether one more may be made at time `now` [ns]; it is counted then, else logged."""
        if len(self._times) == RECOVERIES and now - self._times[0] < RECOVERY_WINDOW_S * SECOND:
            log.error("%d recoveries within %d s: ends", RECOVERIES, RECOVERY_WINDOW_S)
            return False
        self._times.append(now)
        return True
