"""Rigid motions as seven numbers: x, y, z [m] and a unit quaternion x, y, z, w.

These functions run many times per lookup, so they work on tuples of floats: for single motions
that is faster than NumPy by an order of magnitude.
"""

from __future__ import annotations

from math import acos, sin, sqrt

Motion = tuple[float, float, float, float, float, float, float]
"""x, y, z [m], then the quaternion x, y, z, w of unit length."""

IDENTITY: Motion = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

_SMALL_ANGLE_COSINE = 1.0 - 1e-12  # beyond it, linear interpolation is exact to the last digits


def compose(first: Motion, second: Motion) -> Motion:
    """Return the motion that applies `second` and then `first`."""
    ax, ay, az, ai, aj, ak, aw = first
    bx, by, bz, bi, bj, bk, bw = second
    # v + 2 w (q x v) + 2 q x (q x v) rotates v by the unit quaternion (q, w).
    ci = 2.0 * (aj * bz - ak * by)
    cj = 2.0 * (ak * bx - ai * bz)
    ck = 2.0 * (ai * by - aj * bx)
    return (
        ax + bx + aw * ci + aj * ck - ak * cj,
        ay + by + aw * cj + ak * ci - ai * ck,
        az + bz + aw * ck + ai * cj - aj * ci,
        aw * bi + ai * bw + aj * bk - ak * bj,
        aw * bj - ai * bk + aj * bw + ak * bi,
        aw * bk + ai * bj - aj * bi + ak * bw,
        aw * bw - ai * bi - aj * bj - ak * bk,
    )


def invert(motion: Motion) -> Motion:
    """Return the inverse motion."""
    x, y, z, i, j, k, w = motion
    ci = 2.0 * (k * y - j * z)
    cj = 2.0 * (i * z - k * x)
    ck = 2.0 * (j * x - i * y)
    return (
        -(x + w * ci - j * ck + k * cj),
        -(y + w * cj - k * ci + i * ck),
        -(z + w * ck - i * cj + j * ci),
        -i,
        -j,
        -k,
        w,
    )


def interpolate(first: Motion, second: Motion, fraction: float) -> Motion:
    """Return the motion at a fraction of the way: translation linear, rotation by slerp.

    The rotation takes the shorter way (Shoemake, SIGGRAPH 1985).
    """
    ax, ay, az, ai, aj, ak, aw = first
    bx, by, bz, bi, bj, bk, bw = second
    cosine = ai * bi + aj * bj + ak * bk + aw * bw
    sign = 1.0
    if cosine < 0.0:  # -q is the same rotation as q
        cosine, sign = -cosine, -1.0
    keep, take = 1.0 - fraction, fraction
    if cosine < _SMALL_ANGLE_COSINE:
        angle = acos(cosine)
        scale = 1.0 / sin(angle)
        f, g = sin(keep * angle) * scale, sign * sin(take * angle) * scale
    else:
        f, g = keep, sign * take
    i, j, k, w = f * ai + g * bi, f * aj + g * bj, f * ak + g * bk, f * aw + g * bw
    shrink = 1.0 / sqrt(i * i + j * j + k * k + w * w)
    return (
        keep * ax + take * bx,
        keep * ay + take * by,
        keep * az + take * bz,
        i * shrink,
        j * shrink,
        k * shrink,
        w * shrink,
    )
