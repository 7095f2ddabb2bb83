"""The control component of the vision framework."""

from cairn.supervision.component import SupervisorComponent


class VisionSupervisor(SupervisorComponent):
    """Loads the vision framework: the camera and the object recognizer, or their stand-ins."""
