"""The main function of a component's own process."""

import faulthandler
import logging
import signal
import sys
from typing import Any

from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.errors import CairnError
from cairn.placement.launcher import TRACEBACK_SIGNAL, start_component
from cairn.placement.main_loop import MainLoop
from cairn.process_exit import ExitReport, end_process, log_reason
from cairn.runtime.launch_request import LaunchRequest

_SWITCH_INTERVAL_S = 0.0005
"""A handler that computes yields to the threads that receive messages after at most so long."""

LOG_FORMAT = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"


def main(argument: dict[str, Any]) -> None:
    """Run the component of the launch request `argument` until it ends or SIGTERM comes."""
    launch = LaunchRequest.model_validate(argument)
    logging.basicConfig(level=logging.INFO, format=LOG_FORMAT, stream=sys.stderr)
    faulthandler.register(TRACEBACK_SIGNAL, all_threads=True)
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    report = ExitReport(False, "it could not join the bus")
    try:
        bus = ZenohBus(open_peer(launch.context.endpoints), launch.context.domain)
        try:
            report = _run(launch, bus)
        finally:
            bus.close()
    except CairnError as error:
        report = ExitReport(False, str(error))
        if error.__cause__ is not None:  # an exception of the plugin: its author needs the trace
            logging.getLogger("cairn").error(
                "component start failed: %s", error, exc_info=error.__cause__
            )
    log_reason(report.reason)
    end_process(report.exit_code)


def _run(launch: LaunchRequest, bus: ZenohBus) -> ExitReport:
    host = start_component(launch, bus)
    loop = MainLoop(host)
    try:
        with loop.stop_signals(signal.SIGTERM, signal.SIGINT):
            loop.run()
    finally:
        host.close()
    return host.exit_report or ExitReport(False, "its loop ended without a report")
