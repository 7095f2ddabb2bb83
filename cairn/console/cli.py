"""`cairn console`: the web page of running robots, or of a recording."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import Annotated

import typer

from cairn.console.companion import ADDRESS
from cairn.console.hub import Hub
from cairn.console.live import LiveSource
from cairn.console.recorded import RecordedOperations, RecordedSource
from cairn.console.server import USUAL_PORT, Address, Console, new_token, token_in
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain
from cairn.terminal.output import line


def console(
    recording: Annotated[
        list[Path] | None,
        typer.Argument(
            help="A recording to play (MCAP): its file, files or folder; by default running robots "
            "are shown.",
            metavar="[RECORDING]...",
            show_default=False,
        ),
    ] = None,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    host: Annotated[
        str, typer.Option(help="Address to listen on; beyond loopback, TLS is needed.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help=f"Port to listen on; 0: any free one; by default {USUAL_PORT} or, on loopback if "
            "that is taken, any free one.",
            show_default=False,
        ),
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option(help="Certificate for TLS (PEM).", metavar="FILE")
    ] = None,
    key: Annotated[
        Path | None, typer.Option(help="Private key of the certificate (PEM).", metavar="FILE")
    ] = None,
    token_file: Annotated[
        Path | None,
        typer.Option(
            help="File with the token, created if missing; by default each start has a new one.",
            metavar="FILE",
        ),
    ] = None,
    allow_origin: Annotated[
        list[str] | None,
        typer.Option(
            help="Let pages of another site connect, such as https://app.foxglove.dev.",
            metavar="ORIGIN",
        ),
    ] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Let browsers watch only.")] = False,
) -> None:
    """Show running robots in a web browser, and steer them; or play a recording.

    Prints the address to open, which contains a secret token. Foxglove, Lichtblick and PlotJuggler
    connect to the same port.
    """
    address = Address(host, port, certificate, key, tuple(allow_origin or ()))
    token = new_token() if token_file is None else token_in(token_file)
    if recording:
        source = RecordedSource(recording)
        hub = Hub(source, "watch", lambda hub: RecordedOperations(hub, source))
    else:
        hub = Hub(LiveSource(connect, domain), "watch" if watch else "steer")
    asyncio.run(_run(Console(hub, address, token), token_file))


async def _run(console: Console, token_file: Path | None) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, console.stop)
    if token_file is None:
        line(f"{ADDRESS}{console.url}")
        line(f"Foxglove: {console.websocket_url}")
    else:  # this output may be kept in a log
        line(f"{ADDRESS}{console.origin}/#token=TOKEN with the token in {token_file}")
    await console.run()
