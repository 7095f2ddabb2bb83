"""The image of a world from an ideal horizontal camera, and the surfaces that it shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.camera_optics import PinholeCamera
from cairn.components.simulation.layout import SURFACES
from cairn.components.simulation.render_kernels import GLASS, PICTURE, SIDE, paint, project
from cairn.components.simulation.textures import (
    PATTERN,
    PATTERN_TEXELS,
    TEXEL_M,
    TextureAtlas,
    object_picture,
)
from cairn.planar.messages import planar_poses
from cairn.planar.poses import Pose
from cairn.schemas.cairn_sim_msgs import WorldGeometry

Array = NDArray[np.float64]

PERSON_M = 1.75
# A person is drawn as a prism with this many sides.
_SIDES = 16
# Brightness of surfaces in full light [gray levels].
_WALL, _FURNITURE, _DARK, _PERSON = 165.0, 115.0, 35.0, 75.0


@dataclass(frozen=True)
class VisibleSurfaces:
    """Upright rectangles.

    `ends` (n, 4) are x1, y1, x2, y2 [m]; seen from a picture's front, the first end is on the left.
    `extents` (n, 2) are the heights of bottom and top [m]. `scales` (n, 3): texels per meter across
    and down, and the texel of the first end. `brightness` (n,) multiplies the texels. `kinds` (n,
    3): kind, texture, and the number of the solid that the surface is a side of, or 0. The ceiling
    [m] is as high as the highest wall.
    """

    ends: Array
    extents: Array
    scales: Array
    brightness: Array
    kinds: NDArray[np.int64]
    ceiling: float

    def with_people(self, people: Array) -> VisibleSurfaces:
        """Return the surfaces with people (k, 3) x, y, radius [m] added."""
        if not len(people):
            return self
        turns = 2 * np.pi * np.arange(_SIDES + 1) / _SIDES
        ring = np.column_stack((np.cos(turns), np.sin(turns)))
        corners = people[:, None, :2] + people[:, 2, None, None] * ring
        ends = np.concatenate((corners[:, :-1], corners[:, 1:]), axis=2).reshape(-1, 4)
        number = np.repeat(np.arange(len(people)), _SIDES)
        count = len(ends)
        solids = int(self.kinds[:, 2].max(initial=0)) + 1 + number
        return VisibleSurfaces(
            np.concatenate((self.ends, ends)),
            np.concatenate((self.extents, np.tile((0.0, PERSON_M), (count, 1)))),
            np.concatenate((self.scales, _pattern_scales(17 * np.arange(count)))),
            np.concatenate((self.brightness, (_PERSON + 30.0 * (number % 4)) * _slant(ends))),
            np.concatenate((self.kinds, np.column_stack((np.zeros((count, 2), np.int64), solids)))),
            self.ceiling,
        )


def surfaces_of(geometry: WorldGeometry) -> tuple[VisibleSurfaces, TextureAtlas]:
    """Return the surfaces of a world and their textures; `CairnError` for unreadable textures."""
    segments = np.array(geometry.segments).reshape(-1, 4)
    seen = np.asarray(geometry.heights > 0)
    segments, solids = segments[seen], np.array(geometry.solids[seen], np.int64)
    surfaces, heights = geometry.surfaces[seen], geometry.heights[seen]
    gray = np.where(solids > 0, _FURNITURE, _WALL)
    gray[surfaces == SURFACES["dark"]] = _DARK
    kinds = np.where(surfaces == SURFACES["glass"], GLASS, SIDE)
    count = len(segments)
    sizes = geometry.object_sizes.reshape(-1, 2)
    pictures = [
        object_picture(texture, int(object_id), (float(size[0]), float(size[1])))
        for texture, object_id, size in zip(
            geometry.object_textures, geometry.object_ids, sizes, strict=True
        )
    ]
    shapes = np.array([one.shape[::-1] for one in pictures], np.float64).reshape(-1, 2)
    things = len(pictures)
    half = 0.5 * sizes[:, 1]
    return VisibleSurfaces(
        np.concatenate((segments, panel_ends(planar_poses(geometry.object_poses), sizes[:, 0]))),
        np.concatenate(
            (
                np.column_stack((np.zeros(count), heights)),
                np.column_stack((geometry.object_zs - half, geometry.object_zs + half)),
            )
        ),
        np.concatenate(
            (
                _pattern_scales(61 * np.arange(count)),
                np.column_stack((shapes / sizes, 0.0 * half)),
            )
        ),
        np.concatenate((gray * _slant(segments), np.ones(things))),
        np.concatenate(
            (
                np.column_stack((kinds, np.full(count, PATTERN), solids)),
                np.column_stack(
                    (np.full(things, PICTURE), 1 + np.arange(things), np.zeros(things, np.int64))
                ),
            )
        ),
        float(heights[solids == 0].max(initial=0.0)),
    ), TextureAtlas.of(pictures)


def panel_ends(poses: Array, widths: Array) -> Array:
    """Return the ends (n, 4) [m] of pictures at `poses` (n, 3); from the front, left one first."""
    half = 0.5 * widths
    aside = np.column_stack((np.sin(poses[:, 2]) * half, -np.cos(poses[:, 2]) * half))
    ends: Array = np.concatenate((poses[:, :2] + aside, poses[:, :2] - aside), axis=1)
    return ends


def _pattern_scales(offsets: NDArray[np.int64]) -> Array:
    """Return scales (n, 3) of surfaces with the pattern, which starts at another texel on each."""
    scales = np.full((len(offsets), 3), 1.0 / TEXEL_M)
    scales[:, 2] = offsets % PATTERN_TEXELS
    return scales


def _slant(ends: Array) -> Array:
    """Return the brightness of surfaces by their direction: between 0.85 and 1."""
    along = np.arctan2(ends[:, 3] - ends[:, 1], ends[:, 2] - ends[:, 0])
    light: Array = 0.925 + 0.075 * np.cos(2.0 * along - 0.6)
    return light


Float32 = NDArray[np.float32]


@dataclass(frozen=True)
class CameraPose:
    """The pose of a camera on the floor [m, rad] and its height above the floor [m]."""

    pose: Pose
    height: float

    def beside(self, right: float) -> CameraPose:
        """Return the pose that is `right` [m] to the right, with the same direction."""
        x, y, theta = self.pose
        place = (x + right * math.sin(theta), y - right * math.cos(theta), theta)
        return CameraPose(place, self.height)


def ideal_image(
    surfaces: VisibleSurfaces,
    atlas: TextureAtlas,
    camera_pose: CameraPose,
    lens: PinholeCamera,
    spread: float = 0.0,
) -> Float32:
    """Return the image (h, w) in the gray levels of full light.

    The light varies by the share `spread` [1] from place to place.
    """
    x, y, theta = camera_pose.pose
    camera = np.array([x, y, camera_pose.height, math.cos(theta), math.sin(theta)])
    glass = np.array([lens.focal, lens.focal, lens.cx, lens.cy])
    seen, which, borders = project(surfaces.ends, camera, glass, lens.width)
    image = np.empty((lens.width, lens.height), np.float32)
    paint(
        seen, which, borders, surfaces.extents, surfaces.scales, surfaces.brightness,
        surfaces.kinds, atlas.sums, atlas.begins, atlas.shapes, atlas.levels, atlas.level_begins,
        camera, glass, surfaces.ceiling, spread, image,
    )  # fmt: skip
    return np.asarray(cv2.transpose(image), np.float32)
