"""The life cycle of a component: states and transitions of ROS 2 managed nodes, and recoveries."""

import logging
from collections import deque
from enum import StrEnum

from cairn.errors import CairnError
from cairn.schemas.lifecycle_msgs.msg import State, TransitionDescription, TransitionEvent
from cairn.schemas.lifecycle_msgs.msg import Transition as RosTransition
from cairn.system.clock import SECOND

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


_STATE_IDS = {
    LifecycleState.UNCONFIGURED: State.PRIMARY_STATE_UNCONFIGURED,
    LifecycleState.INACTIVE: State.PRIMARY_STATE_INACTIVE,
    LifecycleState.ACTIVE: State.PRIMARY_STATE_ACTIVE,
    LifecycleState.FINALIZED: State.PRIMARY_STATE_FINALIZED,
}


def ros_state(state: str) -> State:
    """Return a state as ROS 2 numbers it; one that managed nodes do not have is unknown."""
    known = _STATE_IDS.get(LifecycleState(state)) if state in set(LifecycleState) else None
    return State(id=known or State.PRIMARY_STATE_UNKNOWN, label=state)


def ros_transition(transition: Transition, start: LifecycleState) -> RosTransition:
    """Return a transition as ROS 2 numbers it, which has one to shut down from each state."""
    numbers = {
        Transition.CONFIGURE: RosTransition.TRANSITION_CONFIGURE,
        Transition.CLEANUP: RosTransition.TRANSITION_CLEANUP,
        Transition.ACTIVATE: RosTransition.TRANSITION_ACTIVATE,
        Transition.DEACTIVATE: RosTransition.TRANSITION_DEACTIVATE,
        Transition.SHUTDOWN: {
            LifecycleState.UNCONFIGURED: RosTransition.TRANSITION_UNCONFIGURED_SHUTDOWN,
            LifecycleState.INACTIVE: RosTransition.TRANSITION_INACTIVE_SHUTDOWN,
        }.get(start, RosTransition.TRANSITION_ACTIVE_SHUTDOWN),
    }
    return RosTransition(id=numbers[transition], label=transition.value)


def possible_transitions(state: LifecycleState | None = None) -> list[TransitionDescription]:
    """Return the transitions that exist from a state, or all, as ROS 2 describes them."""
    return [
        TransitionDescription(
            transition=ros_transition(transition, start),
            start_state=ros_state(start),
            goal_state=ros_state(target),
        )
        for (start, transition), target in _TARGETS.items()
        if state in (None, start)
    ]


def transition_event(
    now: int, transition: Transition, start: LifecycleState, target: LifecycleState
) -> TransitionEvent:
    """Return the message about a transition that was made at time `now` [ns]."""
    return TransitionEvent(
        timestamp=max(0, now),
        transition=ros_transition(transition, start),
        start_state=ros_state(start),
        goal_state=ros_state(target),
    )


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
