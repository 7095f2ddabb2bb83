"""Requests of the fault tests to a running deployment."""

from cairn import RELIABLE
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.geometry_msgs import Point, Pose, PoseStamped
from cairn.testing.launching import Run
from tests.cairn.bus.network import eventually
from tests.commands import cairn
from tests.patience import LIMIT_S


def set_fault(run: Run, fault: str, component: str = "base") -> None:
    """Have a `test_faulty` fail at its next tick."""
    answer = cairn("param", "set", component, f"fault={fault}", connect=run.endpoint)
    # A fault that ends the process at once may prevent its reply.
    assert answer.code == 0 or "no reply to set_parameters" in answer.err, f"{answer}; {run}"


def send_goal(run: Run, x: float, y: float) -> None:
    """Publish a goal for the robot, as a node of another program does."""
    bus = ZenohBus(open_peer([run.endpoint]))
    try:
        node = bus.node("/operator", _fail)
        publisher = node.advertise("/robot/goal_pose", PoseStamped, RELIABLE)
        # Messages take the direct links once these are there.
        assert bus.wait_for_peers(LIMIT_S) == []
        # Components wait only briefly for a session that is not of their run, as this one is not.
        assert eventually(lambda: publisher.has_subscribers)
        publisher.publish(PoseStamped(pose=Pose(position=Point(x=x, y=y))))
    finally:
        bus.close()


def _fail(problem: str) -> None:
    raise AssertionError(problem)
