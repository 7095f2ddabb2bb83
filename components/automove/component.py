"""The component that takes orders to move and loads the plugins which carry them out."""

from typing import Literal

from pydantic import Field

from cairn.component.handlers import on
from cairn.component.parameters import Config
from cairn.component.ports import In
from cairn.supervision.component import SupervisorComponent
from cairn.supervision.supervisor import StartFailed
from schemas.geometry_msgs import PoseStamped


class AutoMoveConfig(Config):
    """When the plugins are loaded."""

    load_plugins: Literal["on_order", "on_activation"] = Field(
        "on_order",
        description="On the first order to move; or at once, where somebody else drives the robot, "
        "as in a recording.",
    )


class AutoMove(SupervisorComponent):
    """Loads Localizer, MapBuilder and the other plugins on an order to move (paper, step 2)."""

    config: AutoMoveConfig

    goal_pose: In[PoseStamped] = In(optional=True)

    def on_activate(self) -> None:
        """Load what the configuration says is loaded before any order."""
        super().on_activate()
        if self.config.load_plugins == "on_activation":
            self._load_plugins()

    @on("goal_pose")
    def order(self, goal: PoseStamped) -> None:
        """Take an order to move: load the plugins that do not run yet."""
        place = goal.pose.position
        self.log.info("ordered to move to %.2f, %.2f: loading plugins", place.x, place.y)
        try:
            self._load_plugins()
        except StartFailed as error:  # those that are loaded already go on with their work
            self.log.error("the order to move cannot be carried out: %s", error)

    def _load_plugins(self) -> None:
        for child in self.children.status():
            try:
                self.children.load(child.name)
            except StartFailed:
                if self.children.stop_requested:  # nobody needs the plugins any more
                    return
                raise
