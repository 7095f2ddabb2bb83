"""The control component of the navigation framework."""

from cairn.supervision.component import SupervisorComponent


class MobileSupervisor(SupervisorComponent):
    """Loads the navigation framework: the base, the range scanner, AutoMove (paper, step 1)."""
