"""The control component of the vision framework."""

from cairn import Supervisor


class VisionSupervisor(Supervisor):
    """Loads the vision framework: the camera and the object recognizer, or their stand-ins."""
