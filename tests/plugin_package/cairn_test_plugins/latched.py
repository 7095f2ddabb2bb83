"""A component that publishes one latched message, and one that reads it."""

from cairn import LATCHED, Component, In, Out, on
from cairn.schemas.geometry_msgs import Point, Pose, PoseStamped


class Beacon(Component):
    """Publishes its pose once."""

    beacon: Out[PoseStamped] = Out(qos=LATCHED)

    def on_activate(self) -> None:
        """Publish the pose."""
        self.beacon.publish(PoseStamped(pose=Pose(position=Point(x=4.0, y=2.0))))


class BeaconReader(Component):
    """Logs the pose of the beacon."""

    beacon: In[PoseStamped] = In(qos=LATCHED)

    @on("beacon")
    def read(self, beacon: PoseStamped) -> None:
        """Log the pose."""
        position = beacon.pose.position
        self.log.info("the beacon stands at %g, %g", position.x, position.y)
