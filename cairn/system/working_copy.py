"""Decides whether a file that a robot keeps is used again, made again or set aside."""

from __future__ import annotations

from logging import Logger
from pathlib import Path

from cairn.system.files import explain_os_error, rename_database


def is_reusable(copy: Path, log: Logger, *, same: bool, ahead: bool) -> bool:
    """Return whether a copy is of the `same` map and not of a time `ahead` (another replay).

    Logs the decision and its reason to `log`.
    """
    if same and not ahead:
        log.info("reusing the working copy %s", copy)
        return True
    why = "it has data of a later time" if same else "it is a copy of another map"
    log.info("replacing the working copy %s: %s", copy, why)
    return False


def path_aside(file: Path) -> Path:
    """Return where `set_aside` keeps a file: NAME.damaged.cairn for NAME.cairn."""
    return file.with_name(f"{file.stem}.damaged{file.suffix}")


def set_aside(damaged: Path, log: Logger, why: object, *more: Path) -> None:
    """Rename a damaged file, and `more` that belong to it, so that new ones can be made.

    Files that were set aside before are replaced. Logs a warning, also if the disk refuses it.
    """
    kept = path_aside(damaged)
    reason = str(why).rstrip(".")
    try:
        for one in (damaged, *more):
            if one.exists():
                rename_database(one, path_aside(one))
    except OSError as error:
        why_kept = explain_os_error(error)
        log.warning("%s cannot be used: %s; not renamed: %s", damaged, reason, why_kept)
    else:
        log.warning("%s cannot be used: %s; it is kept as %s", damaged, reason, kept)
