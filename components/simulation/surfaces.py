"""The upright surfaces that a camera sees: walls, sides of furniture, pictures, people."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.atlas import PATTERN, TEXEL_M, Atlas
from cairn.components.simulation.scene import SURFACES
from cairn.components.simulation.textures import PATTERN_TEXELS, picture_of
from cairn.planar.messages import planar_poses
from cairn.schemas.cairn_sim_msgs import Scene

Array = NDArray[np.float64]

# Kinds of surfaces.
SIDE, GLASS, PICTURE = 0, 1, 2
PERSON_M = 1.75
# A person is drawn as a prism of so many sides.
_SIDES = 16
# Brightness of surfaces in full light [gray levels].
_WALL, _FURNITURE, _DARK, _PERSON = 165.0, 115.0, 35.0, 75.0


@dataclass(frozen=True)
class Surfaces:
    """Upright rectangles.

    `ends` (n, 4) are x1, y1, x2, y2 [m]; who sees a picture from its front has the first on the
    left. `extents` (n, 2) are the heights of bottom and top [m]. `scales` (n, 3): texels per meter
    across and down, and that of the first end. `brightness` (n,) is what texels are multiplied by.
    `kinds` (n, 3): kind, texture, and the number of the solid that it is a side of, or 0. The
    ceiling is as high [m] as the highest wall.
    """

    ends: Array
    extents: Array
    scales: Array
    brightness: Array
    kinds: NDArray[np.int64]
    ceiling: float

    def with_people(self, people: Array) -> Surfaces:
        """With people (k, 3) x, y, radius [m] among them."""
        if not len(people):
            return self
        turns = 2 * np.pi * np.arange(_SIDES + 1) / _SIDES
        ring = np.column_stack((np.cos(turns), np.sin(turns)))
        corners = people[:, None, :2] + people[:, 2, None, None] * ring
        ends = np.concatenate((corners[:, :-1], corners[:, 1:]), axis=2).reshape(-1, 4)
        number = np.repeat(np.arange(len(people)), _SIDES)
        count = len(ends)
        solids = int(self.kinds[:, 2].max(initial=0)) + 1 + number
        return Surfaces(
            np.concatenate((self.ends, ends)),
            np.concatenate((self.extents, np.tile((0.0, PERSON_M), (count, 1)))),
            np.concatenate((self.scales, _pattern_scales(17 * np.arange(count)))),
            np.concatenate((self.brightness, (_PERSON + 30.0 * (number % 4)) * _slant(ends))),
            np.concatenate((self.kinds, np.column_stack((np.zeros((count, 2), np.int64), solids)))),
            self.ceiling,
        )


def surfaces_of(scene: Scene) -> tuple[Surfaces, Atlas]:
    """What stands, and its textures; `CairnError` if a texture's file cannot be read."""
    segments = np.array(scene.segments).reshape(-1, 4)
    seen = np.asarray(scene.heights > 0)
    segments, solids = segments[seen], np.array(scene.solids[seen], np.int64)
    surfaces, heights = scene.surfaces[seen], scene.heights[seen]
    gray = np.where(solids > 0, _FURNITURE, _WALL)
    gray[surfaces == SURFACES["dark"]] = _DARK
    kinds = np.where(surfaces == SURFACES["glass"], GLASS, SIDE)
    count = len(segments)
    sizes = scene.object_sizes.reshape(-1, 2)
    pictures = [
        picture_of(texture, int(object_id), (float(size[0]), float(size[1])))
        for texture, object_id, size in zip(
            scene.object_textures, scene.object_ids, sizes, strict=True
        )
    ]
    shapes = np.array([one.shape[::-1] for one in pictures], np.float64).reshape(-1, 2)
    things = len(pictures)
    half = 0.5 * sizes[:, 1]
    return Surfaces(
        np.concatenate((segments, panel_ends(planar_poses(scene.object_poses), sizes[:, 0]))),
        np.concatenate(
            (
                np.column_stack((np.zeros(count), heights)),
                np.column_stack((scene.object_zs - half, scene.object_zs + half)),
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
    ), Atlas.of(pictures)


def panel_ends(poses: Array, widths: Array) -> Array:
    """The ends (n, 4) [m] of pictures at `poses` (n, 3): from the front, the left one first."""
    half = 0.5 * widths
    aside = np.column_stack((np.sin(poses[:, 2]) * half, -np.cos(poses[:, 2]) * half))
    ends: Array = np.concatenate((poses[:, :2] + aside, poses[:, :2] - aside), axis=1)
    return ends


def _pattern_scales(offsets: NDArray[np.int64]) -> Array:
    """Scales (n, 3) of surfaces with the pattern, which begins elsewhere on each."""
    scales = np.full((len(offsets), 3), 1.0 / TEXEL_M)
    scales[:, 2] = offsets % PATTERN_TEXELS
    return scales


def _slant(ends: Array) -> Array:
    """How light surfaces are that look in different directions: between 0.85 and 1."""
    along = np.arctan2(ends[:, 3] - ends[:, 1], ends[:, 2] - ends[:, 0])
    light: Array = 0.925 + 0.075 * np.cos(2.0 * along - 0.6)
    return light
