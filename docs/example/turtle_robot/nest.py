"""The turtle's nest, a task component with a service and an action: charges the turtle."""

from typing import Any

from cairn import (
    ActionServer,
    CairnError,
    Client,
    Component,
    In,
    Server,
    ServerGoal,
    cancel,
    goal,
    on,
    serve,
)
from cairn.schemas.nav2_msgs.action import DockRobot
from cairn.schemas.std_srvs.srv import SetBool

from turtle_robot.messages import BaseState


class Nest(Component):
    """Keeps a docked turtle until it is charged; the lamp is on meanwhile."""

    base_state: In[BaseState]
    dock: ActionServer[DockRobot.Goal, DockRobot.Result, DockRobot.Feedback]
    close_nest: Server[SetBool.Request, SetBool.Response]
    lamp: Client[SetBool.Request, SetBool.Response] = Client(optional=True)

    def on_configure(self) -> None:
        """Open the nest."""
        self._closed = False

    @serve("close_nest")
    def on_close(self, request: SetBool.Request) -> SetBool.Response:
        """Close or open the nest; the text of a `CairnError` is the client's error."""
        if self.dock.goals:
            raise CairnError("a turtle is in the nest")
        self._closed = request.data
        return SetBool.Response(success=True)

    @goal("dock")
    def on_dock(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Begin to pursue a goal; a `CairnError` rejects it."""
        if self._closed:
            raise CairnError("the nest is closed")
        self.lamp.call(SetBool.Request(data=True), self.on_lamp)

    def on_lamp(self, response: SetBool.Response) -> None:
        """Handle the response: called later, as all handlers of this component."""
        self.log.info("the lamp is on")

    @on("base_state")
    def on_base_state(self, state: BaseState) -> None:
        """Publish feedback; end the goals by `succeed`, `abort` or `canceled`."""
        for docked in self.dock.goals:
            docked.publish_feedback(DockRobot.Feedback(state=DockRobot.Feedback.WAIT_FOR_CHARGE))
            if state.charge == 1.0:
                docked.succeed(DockRobot.Result(success=True))

    @cancel("dock")
    def on_cancel(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Cancel a goal; a `CairnError` lets it continue."""
        goal.canceled(DockRobot.Result(success=False))
