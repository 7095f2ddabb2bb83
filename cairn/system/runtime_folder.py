"""The runtime folder: where a user's sockets are, which no other user may open or replace."""

from __future__ import annotations

import fcntl
import grp
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from cairn.errors import CairnError
from cairn.system.files import explain_os_error

VARIABLE: Final = "CAIRN_RUNTIME_DIR"
"""The environment variable that names the runtime folder."""

LONGEST_SOCKET_PATH: Final = 107
"""Longest path of a Unix socket [bytes]: unix(7)."""

PRIVATE_MODE: Final = 0o700
GROUP_MODE: Final = 0o750
_GROUP_SOCKET_MODE: Final = 0o660
_RUNS: Final = "run-"
_USER_FOLDERS: Final = Path("/run/user")  # made by systemd-logind, one for each user


def runtime_folder() -> Path:
    """Return the runtime folder of the current user: its path only, nothing is created.

    `$CAIRN_RUNTIME_DIR`; else `cairn` in `$XDG_RUNTIME_DIR`; else `cairn` in `/run/user/UID`, if
    that folder exists and is the user's; else `/tmp/cairn-UID`.
    """
    if named := os.environ.get(VARIABLE):
        return Path(named).absolute()
    if base := os.environ.get("XDG_RUNTIME_DIR"):  # an empty one counts as unset
        return Path(base).absolute() / "cairn"
    uid = os.geteuid()
    base_of_user = _USER_FOLDERS / str(uid)
    with suppress(OSError):
        if base_of_user.lstat().st_uid == uid:
            return base_of_user / "cairn"
    return Path(f"/tmp/cairn-{uid}")


def private_folder(
    path: Path, group: str | None = None, *, content: str = "sockets", variable: str = VARIABLE
) -> Path:
    """Create a folder that only its owner may use, or check that it is one; return its path.

    With `group`, the members of that group may reach what is in it, but change nothing. `content`
    and the environment variable by which users name another folder are for messages. Raises
    `CairnError` if it cannot be created, is a link, belongs to another user, or is open to others.
    """
    gid = None if group is None else group_id(group)
    try:
        path.mkdir(mode=PRIVATE_MODE, parents=True, exist_ok=True)
        check_private(path, content=content, variable=variable)
        if gid is not None:
            os.chown(path, -1, gid)
            path.chmod(GROUP_MODE)
    except OSError as error:
        raise CairnError(
            f"{path}: the folder for {content} cannot be created, or opened to a group: "
            f"{error.strerror}; set {variable} to a folder of yours"
        ) from error
    return path


def check_private(path: Path, *, content: str = "sockets", variable: str = VARIABLE) -> None:
    """Raise `CairnError` unless an existing folder belongs to this user, and only it may write.

    The folder's group may read it: only its owner can have allowed that. Raises `OSError` if the
    folder does not exist.
    """
    status, parent = path.lstat(), path.parent.stat()
    if not stat.S_ISDIR(status.st_mode):
        kind = "a link" if stat.S_ISLNK(status.st_mode) else "not a folder"
        raise CairnError(
            f"{path}: it is {kind}, which another user may have put there; remove it, or set "
            f"{variable} to a folder of yours"
        )
    if status.st_uid != os.geteuid():
        raise CairnError(
            f"{path}: it belongs to user {status.st_uid}, but this is user {os.geteuid()}; set "
            f"{variable} to a folder of yours"
        )
    if status.st_mode & (stat.S_IRWXO | stat.S_IWGRP):
        raise CairnError(
            f"{path}: its mode {stat.S_IMODE(status.st_mode):04o} lets other users in, who could "
            f"then drive the robot; use a folder with nothing but {content} that only you may "
            f"open (chmod 700), or set {variable} to one"
        )
    if parent.st_mode & stat.S_IWOTH and not parent.st_mode & stat.S_ISVTX:
        raise CairnError(
            f"{path}: any user may replace it, because {path.parent} has the mode "
            f"{stat.S_IMODE(parent.st_mode):04o}; set {variable} to a folder of yours"
        )


def group_id(group: str) -> int:
    """Return the number of a group; `CairnError` if the system does not know it."""
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        raise CairnError(
            f"bus.group: there is no group {group} on this computer; create it "
            f"(groupadd {group}), or name another one"
        ) from None


def open_to_group(socket: Path, group: str) -> None:
    """Let the members of a group connect to a Unix socket of this user."""
    try:
        os.chown(socket, -1, group_id(group))
        socket.chmod(_GROUP_SOCKET_MODE)
    except OSError as error:
        raise CairnError(
            f"{socket}: it cannot be opened to the group {group}: {error.strerror}; name a group "
            "that you are a member of (bus.group)"
        ) from error


def check_length(socket: Path) -> Path:
    """Return the path of a Unix socket; `CairnError` if it is too long for one."""
    length = len(os.fsencode(socket))
    if length > LONGEST_SOCKET_PATH:
        raise CairnError(
            f"{socket}: the path of the socket has {length} bytes and may have "
            f"{LONGEST_SOCKET_PATH}; set {VARIABLE} to a folder with a shorter path"
        )
    return socket


@contextmanager
def run_folder() -> Iterator[Path]:
    """Create a private folder for the sockets of one run; it is removed at the end.

    The folders of runs that were killed are removed as well. Raises `CairnError` if the folder
    cannot be created.
    """
    base = private_folder(runtime_folder())
    with ExitStack() as held:
        with locked(base):  # or another start removes the new folder before that is locked
            for old in base.glob(f"{_RUNS}*"):
                with suppress(OSError), locked(old, wait=False):
                    shutil.rmtree(old, ignore_errors=True)
            try:
                folder = Path(tempfile.mkdtemp(prefix=_RUNS, dir=base))
            except OSError as error:
                raise CairnError(f"{base}: {explain_os_error(error)}, or set {VARIABLE}") from error
            held.enter_context(locked(folder))
        held.callback(shutil.rmtree, folder, ignore_errors=True)
        yield folder


@contextmanager
def locked(folder: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold the lock of a folder; `OSError` if it is held already and `wait` is False."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)
