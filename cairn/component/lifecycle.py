"""The life cycle of a component, as in ROS 2 managed nodes, with its error transitions."""

from enum import StrEnum

from cairn.errors import CairnError


class State(StrEnum):
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
    (State.UNCONFIGURED, Transition.CONFIGURE): State.INACTIVE,
    (State.INACTIVE, Transition.ACTIVATE): State.ACTIVE,
    (State.ACTIVE, Transition.DEACTIVATE): State.INACTIVE,
    (State.INACTIVE, Transition.CLEANUP): State.UNCONFIGURED,
    (State.UNCONFIGURED, Transition.SHUTDOWN): State.FINALIZED,
    (State.INACTIVE, Transition.SHUTDOWN): State.FINALIZED,
    (State.ACTIVE, Transition.SHUTDOWN): State.FINALIZED,
}


def goal(state: State, transition: Transition) -> State:
    """The state that a transition leads to if it succeeds.

    Raises `CairnError` if the transition does not begin in that state.
    """
    if (state, transition) not in _GOAL:
        possible = [other.value for begin, other in _GOAL if begin is state]
        raise CairnError(
            f"cannot {transition} in state {state}; possible are {', '.join(possible) or 'none'}"
        )
    return _GOAL[state, transition]
