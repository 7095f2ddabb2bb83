"""A component that uses a service and an action: none of the simulated robot uses both."""

from cairn import ActionClient, Client, Component
from cairn.schemas.nav2_msgs.action import ComputePathToPose
from cairn.schemas.std_srvs.srv import Trigger


class Guide(Component):
    """Requests paths, and rings a bell."""

    compute_path_to_pose: ActionClient[
        ComputePathToPose.Goal, ComputePathToPose.Result, ComputePathToPose.Feedback
    ]
    ring: Client[Trigger.Request, Trigger.Response] = Client(optional=True)
