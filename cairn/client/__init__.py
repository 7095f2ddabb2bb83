"""Client API of a running deployment, for scripts, notebooks, tests and the `cairn` command.

```python
import cairn.client

with cairn.client.connect() as robot:
    print(list(robot.components()))
    status = robot.go(2.0, 1.2).result(timeout_s=120.0)
```
"""

from cairn.bus.bus import ServiceError
from cairn.bus.control import ControlError, NoReplyError
from cairn.client.connection import Connection
from cairn.client.graph import Endpoint, NodeInfo
from cairn.client.navigation import NavigationGoal
from cairn.client.robot import Parameter, Robot, Topic, TopicInfo, connect
from cairn.client.services import RunningGoal, ServiceInfo
from cairn.client.subscription import NoMessageError, Subscription
from cairn.client.transforms import TransformListener
from cairn.client.velocity_gate import Teleoperation

__all__ = [
    "Connection",
    "ControlError",
    "Endpoint",
    "NavigationGoal",
    "NoMessageError",
    "NoReplyError",
    "NodeInfo",
    "Parameter",
    "Robot",
    "RunningGoal",
    "ServiceError",
    "ServiceInfo",
    "Subscription",
    "Teleoperation",
    "Topic",
    "TopicInfo",
    "TransformListener",
    "connect",
]
