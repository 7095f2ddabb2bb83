"""A component that publishes once, latched, and one that waits for it."""

from cairn import LATCHED, Component, In, Out, on
from cairn.schemas.geometry_msgs import Point, Pose, PoseStamped


class Beacon(Component):
    """Says once where it stands."""

    beacon: Out[PoseStamped] = Out(qos=LATCHED)

    def on_activate(self) -> None:
        """Say it."""
        self.beacon.publish(PoseStamped(pose=Pose(position=Point(x=4.0, y=2.0))))


class BeaconReader(Component):
    """Logs where the beacon stands."""

    beacon: In[PoseStamped] = In(qos=LATCHED)

    @on("beacon")
    def read(self, beacon: PoseStamped) -> None:
        """Log it."""
        place = beacon.pose.position
        self.log.info("the beacon stands at %g, %g", place.x, place.y)
