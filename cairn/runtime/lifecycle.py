"""The life cycle of a component: states and transitions of ROS 2 managed nodes, and recoveries."""

import logging
from collections import deque
from enum import StrEnum

from cairn.clock import SECOND
from cairn.errors import CairnError

MAX_RECOVERIES = 3
RECOVERY_WINDOW_S = 10


class LifecycleState(StrEnum):
    """The primary states of a component, as in ROS 2 managed nodes."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


class Transition(StrEnum):
    """The transitions that can be requested of a component."""

    CONFIGURE = "configure"
    ACTIVATE = "activate"
    DEACTIVATE = "deactivate"
    CLEANUP = "cleanup"
    SHUTDOWN = "shutdown"


_TARGETS = {
    (LifecycleState.UNCONFIGURED, Transition.CONFIGURE): LifecycleState.INACTIVE,
    (LifecycleState.INACTIVE, Transition.ACTIVATE): LifecycleState.ACTIVE,
    (LifecycleState.ACTIVE, Transition.DEACTIVATE): LifecycleState.INACTIVE,
    (LifecycleState.INACTIVE, Transition.CLEANUP): LifecycleState.UNCONFIGURED,
    (LifecycleState.UNCONFIGURED, Transition.SHUTDOWN): LifecycleState.FINALIZED,
    (LifecycleState.INACTIVE, Transition.SHUTDOWN): LifecycleState.FINALIZED,
    (LifecycleState.ACTIVE, Transition.SHUTDOWN): LifecycleState.FINALIZED,
}

STATE_AFTER = {
    transition.value: target
    for (_, transition), target in _TARGETS.items()
    if transition is not Transition.SHUTDOWN
}
"""The state to which each transition leads in which a component stays."""


def target_state(state: LifecycleState, transition: Transition) -> LifecycleState:
    """Return the state that a transition leads to if it succeeds.

    Raises `CairnError` if the transition does not exist in that state.
    """
    if (state, transition) not in _TARGETS:
        possible = [other.value for start, other in _TARGETS if start is state]
        raise CairnError(
            f"cannot {transition} in state {state}; possible are {', '.join(possible) or 'none'}"
        )
    return _TARGETS[state, transition]


class RecoveryLimit:
    """Limits how often a component recovers from errors by itself: 3 times within 10 s."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=MAX_RECOVERIES)

    def allow(self, now: int, log: logging.Logger) -> bool:
        """Count a recovery at time `now` [ns] and return True; log and return False if too many."""
        if len(self._times) == MAX_RECOVERIES and now - self._times[0] < RECOVERY_WINDOW_S * SECOND:
            log.error(
                "no further recovery: %d within %d s is the limit",
                MAX_RECOVERIES,
                RECOVERY_WINDOW_S,
            )
            return False
        self._times.append(now)
        return True
