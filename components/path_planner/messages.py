"""Plans as messages."""

from __future__ import annotations

import numpy as np

from cairn.components.path_planner.planning import Answer
from cairn.planar.messages import packed_poses, pose_message
from cairn.schemas.cairn_nav_msgs import Plan
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.nav_msgs import Path
from cairn.schemas.std_msgs import Header

SHOWN = 500  # poses of a path that people look at


def plan_message(header: Header, goal_id: int, answer: Answer) -> Plan:
    """An answer to a goal_id."""
    nearest = answer.nearest or (float("nan"), float("nan"))
    told = Plan(
        header=header,
        goal_id=goal_id,
        outcome=int(answer.outcome),
        reason=answer.reason,
        nearest_x=nearest[0],
        nearest_y=nearest[1],
    )
    if answer.route is None:
        return told
    return Plan(
        header=header,
        goal_id=goal_id,
        outcome=int(answer.outcome),
        length=answer.route.length(),
        poses=packed_poses(answer.route.poses),
    )


def path_message(header: Header, answer: Answer) -> Path:
    """The poses of an answer, at most some SHOWN of them, none if there is no route."""
    if answer.route is None:
        return Path(header=header)
    poses = answer.route.poses
    shown = np.linspace(0, len(poses) - 1, min(len(poses), SHOWN)).astype(np.int64)
    return Path(
        header=header,
        poses=tuple(
            PoseStamped(header=header, pose=pose_message((x, y, theta)))
            for x, y, theta in poses[shown].tolist()
        ),
    )
