"""Why a file cannot be read or written, and what helps, in words."""

from __future__ import annotations

import errno
from typing import Final

_ROOM: Final = "free some space on its disk"
_PERMISSION: Final = "give yourself the permission, or name another path"

_REMEDIES: Final = {
    errno.ENOSPC: _ROOM,
    errno.EDQUOT: _ROOM,
    errno.EACCES: _PERMISSION,
    errno.EPERM: _PERMISSION,
    errno.EROFS: "its disk can only be read: name another path",
    errno.EISDIR: "it is a folder: name a file",
    errno.ENOTDIR: "a part of the path is a file, not a folder: correct it",
    errno.EEXIST: "something else has this name: name another path",
    errno.ENOENT: "correct the path",
    errno.EIO: "its disk fails: look into the system's log",
}


def why(error: OSError) -> str:
    """What is wrong, as the system says, and the remedy."""
    remedy = _REMEDIES.get(error.errno or 0, "correct the path, or what is there")
    return f"{error.strerror or error}; {remedy}"
