"""Finds the scans among what a sensor sends, and counts what is not one."""

from __future__ import annotations

from cairn.components.hokuyo.replies import Reply
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scan_data import ScanData, scan_data
from cairn.components.hokuyo.scip1 import gather, scan_data_1
from cairn.components.hokuyo.scip_text import ScipError

_DATA = "99"
_BROKEN = range(50, 98)  # statuses by which a sensor says that it has a defect
_BEGUN = "00"


class Defect(Exception):  # noqa: N818 - it tells what a sensor has
    """A sensor says that its hardware has a defect; `code` is its status."""

    def __init__(self, code: str) -> None:
        super().__init__(code)
        self.code = code


class ScanStream:
    """The scans of one request. The counts are of all requests since it was made."""

    def __init__(self) -> None:
        self.good = 0
        self.damaged = 0
        self.last_damage = ""
        self.statuses: dict[str, int] = {}
        """How often the sensor sent a status in place of a scan, by status."""

    def take(self, reply: Reply, request: ScanRequest, *, scip2: bool) -> ScanData | None:
        """The scan in a reply; None if it holds none, or a damaged one, which is counted.

        Raises `Defect` if the sensor says that it is broken.
        """
        try:
            data = self._scan2(reply, request) if scip2 else self._scan1(reply, request)
        except ScipError as error:
            self.damaged += 1
            self.last_damage = str(error)
            return None
        if data is not None:
            self.good += 1
        return data

    def _scan2(self, reply: Reply, request: ScanRequest) -> ScanData | None:
        if not request.is_echo(reply.echo):
            raise ScipError(f"a reply begins with {reply.echo[:40]!r}")
        code = reply.code()
        if code == _DATA:
            return scan_data(reply, request)
        if code != _BEGUN:
            self.statuses[code] = self.statuses.get(code, 0) + 1
        if code.isdigit() and int(code) in _BROKEN:
            raise Defect(code)
        return None

    def _scan1(self, reply: Reply, request: ScanRequest) -> ScanData:
        if not reply.echo.endswith(gather(request).encode("ascii")):
            raise ScipError(f"a reply begins with {reply.echo[:40]!r}")
        return scan_data_1(reply, request)
