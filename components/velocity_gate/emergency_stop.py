"""Emergency stop: latched, and kept in a file, so that it survives a restart of the gate."""

from __future__ import annotations

import json
from pathlib import Path

from cairn import CairnError
from cairn.limits.files import read_bounded
from cairn.system.files import explain_os_error, replace_file

_MOST_REASON = 200  # characters of the reason that are kept
_MOST_BYTES = 4096  # of the file


class EmergencyStop:
    """Whether the stop is engaged, and why.

    It fails closed: if the state before a restart is not known, the stop is engaged.
    """

    def __init__(self, file: Path | None, *, restarted: bool) -> None:
        """Take the state from the file, if one is given.

        Raises `CairnError` if its folder does not exist.
        """
        self._file = file
        self.problem = ""
        """Why the state could not be saved; empty if it was."""
        if file is not None and not file.parent.is_dir():
            raise CairnError(
                f"{file.parent}: no such folder to keep the emergency stop in (state_file); create "
                "it, or give another state_file"
            )
        self.reason = self._loaded(restarted)
        """Why the stop is engaged; empty if it is released."""
        self._save()

    @property
    def engaged(self) -> bool:
        """Whether the robot must stand."""
        return bool(self.reason)

    def engage(self, reason: str) -> bool:
        """Engage the stop; return whether it was released before."""
        if self.engaged:
            return False
        printable = "".join(one if one.isprintable() else " " for one in reason)
        self.reason = printable[:_MOST_REASON].strip() or "requested"
        self._save()
        return True

    def release(self) -> bool:
        """Release the stop; return whether it was engaged before."""
        before, self.reason = self.engaged, ""
        self._save()
        return before

    def _loaded(self, restarted: bool) -> str:
        unknown = "the gate ended without a record of the emergency stop"
        if self._file is None:
            return f"{unknown} (no state_file)" if restarted else ""
        try:
            state = json.loads(read_bounded(self._file, _MOST_BYTES))
            if state["engaged"] is False:
                return ""
            return str(state["reason"])[:_MOST_REASON] or unknown
        except FileNotFoundError:
            return f"{unknown} ({self._file} is missing)" if restarted else ""
        except (OSError, ValueError, LookupError, TypeError, RecursionError):
            return f"{unknown} ({self._file} cannot be read)"

    def _save(self) -> None:
        """Save the state; if that fails, remove the file, so that a restarted gate stands."""
        self.problem = ""
        if self._file is None:
            return
        state = json.dumps({"engaged": self.engaged, "reason": self.reason})
        try:
            replace_file(self._file, state.encode())
        except OSError as error:
            self.problem = (
                f"the state of the emergency stop cannot be saved to {self._file}: "
                f"{explain_os_error(error)}"
            )
            if self.engaged:
                try:
                    self._file.unlink(missing_ok=True)
                except OSError:
                    self.problem += "; a restarted gate may take it for released"
