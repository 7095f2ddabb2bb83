"""The scene as messages: for the drivers of sensors, and as the map that would be true."""

from __future__ import annotations

import numpy as np

from cairn.components.simulation.scene import Scene
from cairn.planar.messages import packed_poses
from cairn.schemas import cairn_sim_msgs
from cairn.schemas.cairn_msgs import VisualMap, VisualObject
from cairn.schemas.std_msgs import Header


def scene_message(header: Header, scene: Scene) -> cairn_sim_msgs.Scene:
    """What stands, for drivers."""
    things = list(scene.objects.values())
    poses = np.array([thing.pose for thing in things], np.float64).reshape(-1, 3)
    sizes = np.array([thing.size for thing in things], np.float64).reshape(-1, 2)
    standing = scene.standing
    return cairn_sim_msgs.Scene(
        header=header,
        segments=standing.segments.ravel(),
        surfaces=standing.surfaces,
        heights=standing.heights,
        solids=standing.solids,
        object_ids=np.array([thing.id for thing in things], np.uint32),
        object_names=tuple(thing.called for thing in things),
        object_poses=packed_poses(poses),
        object_sizes=sizes.ravel(),
        object_zs=np.array([thing.z for thing in things], np.float64),
        object_textures=tuple(str(thing.texture or "") for thing in things),
    )


def true_map(header: Header, scene: Scene) -> VisualMap:
    """The visual map as it would have to be."""
    return VisualMap(
        header=header,
        version=scene.version,
        objects=tuple(
            VisualObject(object_id=thing.id, name=thing.called, x=thing.x, y=thing.y)
            for thing in scene.objects.values()
        ),
    )
