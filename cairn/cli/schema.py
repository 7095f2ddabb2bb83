"""`cairn schema list|show`: the messages on the bus, for users of any language."""

from typing import Annotated

import typer

from cairn.bus.codec import Codec
from cairn.cli.connection import Json
from cairn.cli.message_types import find_message, known_messages
from cairn.cli.tables import line, print_json, show

app = typer.Typer(help="The message types: ROS 2 definition text and type hash.")


@app.command("list")
def list_(json: Json = False) -> None:
    """List the message types with their ROS 2 type hashes."""
    codec = Codec()
    rows = [
        {
            "type": name,
            "hash": codec.type_hash(message),
            "summary": (message.__doc__ or "").partition("\n")[0],
        }
        for name, message in sorted(known_messages().items())
    ]
    show(rows, ("type", "hash", "summary"), as_json=json)


@app.command("show")
def show_(
    type_name: Annotated[str, typer.Argument(metavar="TYPE", help="As in nav_msgs/msg/Odometry.")],
    json: Json = False,
) -> None:
    """Print a type's ROS 2 definition, with those of the types that it holds, and its hash."""
    codec = Codec()
    message = find_message(type_name)
    definition = codec.definition(message)
    if json:
        print_json({"type": type_name, "hash": codec.type_hash(message), "definition": definition})
        return
    line(f"# {type_name}\n# {codec.type_hash(message)}\n{definition.rstrip()}")
