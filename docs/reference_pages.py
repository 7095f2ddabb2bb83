"""Generates the reference pages of the site from the code: commands, messages, parameters, files.

A hook of MkDocs (`hooks:` in mkdocs.yml). The pages exist only in the built site.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.metadata import entry_points
from inspect import cleandoc, getdoc
from itertools import groupby
from typing import Any, get_args, get_origin

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from typer.core import TyperGroup

from cairn import Component
from cairn.bus.type_hash import definition, type_hash
from cairn.cli.main import build
from cairn.components.simulation.world_file import WorldFile
from cairn.deployment.plugins import installed_plugins, load_plugin
from cairn.runtime.parameters import bounds_text
from cairn.runtime.ports import ports_of
from cairn.schemas.interfaces import interface, interface_type_names
from cairn.schemas.message import schema_messages, type_name

PACKAGES = ("cairn-robotics", "cairn-lab")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages to those that MkDocs read from docs/."""
    pages = {
        "reference/cli.md": _commands_page(),
        "reference/messages.md": _messages_page(),
        "reference/plugins.md": _plugins_page(),
        "reference/campaigns.md": _campaigns_page(),
        "reference/worlds.md": _worlds_page(),
    }
    for path, text in pages.items():
        files.append(File.generated(config, path, content=text))
    return files


def _commands_page() -> str:
    command = typer.main.get_command(build())
    intro = "# Commands\n\nEvery command prints this text with `--help`.\n"
    return intro + "".join(_command_sections(typer.Context(command, info_name="cairn")))


def _command_sections(context: typer.Context) -> Iterator[str]:
    command = context.command
    depth = context.command_path.count(" ")
    if depth:
        yield f"\n{'#' * min(depth + 1, 4)} {context.command_path}\n\n"
        yield f"```text\n{command.get_help(context)}\n```\n"
    if isinstance(command, TyperGroup):
        for name in command.list_commands(context):
            child = command.get_command(context, name)
            if child is not None:
                yield from _command_sections(
                    typer.Context(child, info_name=name, parent=context, max_content_width=100)
                )


def _messages_page() -> str:
    parts = [
        "# Messages\n\nThe types of messages, services and actions that Cairn ships. Messages that "
        "Cairn's components use have their definitions here; `cairn schema show TYPE` prints those "
        "of all types. [Use and import ROS 2 types](../how-to/messages.md) shows how to use them.\n"
    ]
    described = schema_messages()
    names = [name for name in interface_type_names() if _is_of_cairn(name)]
    for package, group in groupby(names, lambda name: name.split("/")[0]):
        parts.append(f"\n## {package}\n")
        others = []
        for name in group:
            if name in described:
                parts.append(_message_section(name, described[name]))
            else:
                others.append(f"`{name.partition('/')[2]}`")
        if others:
            parts.append(f"\nDefined as in ROS 2: {', '.join(others)}\n")
    return "".join(parts)


def _is_of_cairn(name: str) -> bool:
    return interface(name).__module__.startswith("cairn.")


def _message_section(name: str, cls: type) -> str:
    return (
        f"\n### {name.split('/')[-1]}\n\n{getdoc(cls) or ''}\n\n"
        f"```text\n{definition(cls).rstrip()}\n```\n\n"
        f"Type hash: `{type_hash(cls)}`\n"
    )


def _plugins_page() -> str:
    parts = [
        "# Plugins\n\nThe components that Cairn ships, with their ports and parameters. "
        "`cairn plugins NAME` prints the same.\n"
    ]
    parts.extend(
        _plugin_section(plugin.name, load_plugin(plugin.name))
        for plugin in installed_plugins()
        if plugin.package.split()[0] in PACKAGES
    )
    return "".join(parts)


def _plugin_section(name: str, cls: type[Component]) -> str:
    lines = [f"\n## {name}\n", getdoc(cls) or "", "", f"Class: `{cls.__module__}:{cls.__name__}`"]
    ports = [
        (f"`{port.name}`", port.direction, f"`{type_name(port.interface)}`", str(port.qos.depth))
        for port in ports_of(cls).values()
    ]
    if ports:
        lines += ["", *_table(("port", "direction", "type", "depth"), ports)]
    parameters = list(_parameters(cls.config_class(), ""))
    if parameters:
        header = ("parameter", "default", "bounds", "meaning")
        lines += ["", *_table(header, parameters)]
    return "\n".join(lines) + "\n"


def _campaigns_page() -> str:
    parts = [
        "# Campaigns\n\nThe faults and invariants of [campaigns](../how-to/campaign.md), with "
        "their parameters.\n"
    ]
    for title, group in (("Faults", "cairn.faults"), ("Invariants", "cairn.invariants")):
        parts.append(f"\n## {title}\n")
        parts.extend(
            _kind_section(entry.name, entry.load())
            for entry in sorted(entry_points(group=group), key=lambda one: one.name)
            if entry.dist is not None and entry.dist.name in PACKAGES
        )
    return "".join(parts)


def _kind_section(name: str, cls: type[Any]) -> str:
    lines = [f"\n### {name}\n", getdoc(cls) or ""]
    rows = list(_parameters(cls.config_type, ""))
    if rows:
        lines += ["", *_table(("parameter", "default", "bounds", "meaning"), rows)]
    return "\n".join(lines) + "\n"


def _worlds_page() -> str:
    header = ("key", "default", "bounds", "meaning")
    intro = (
        "# World files\n\nThe keys of [files of simulated worlds]"
        "(../how-to/simulation.md#write-a-world-file); `[]` is each element of a list.\n\n"
    )
    header = ("key", "default", "bounds", "meaning")
    return intro + "\n".join(_table(header, list(_keys(WorldFile, "")))) + "\n"


def _keys(model: type[BaseModel], prefix: str) -> Iterator[tuple[str, str, str, str]]:
    """Yield a row for each key of a model, and for those of the models in its lists."""
    for name, field in model.model_fields.items():
        yield f"`{prefix}{name}`", _default(field), bounds_text(field), field.description or ""
        if get_origin(field.annotation) is list:
            (element,) = get_args(field.annotation)
            if isinstance(element, type) and issubclass(element, BaseModel):
                yield from _keys(element, f"{prefix}{name}[].")


def _parameters(config: type[BaseModel], prefix: str) -> Iterator[tuple[str, str, str, str]]:
    for name, field in config.model_fields.items():
        group = field.annotation
        if isinstance(group, type) and issubclass(group, BaseModel):
            yield from _parameters(group, f"{prefix}{name}.")
        else:
            yield f"`{prefix}{name}`", _default(field), bounds_text(field), field.description or ""


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={})
    return f"`{value:.7g}`" if isinstance(value, float) else f"`{value}`"


def _table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    cells = [
        [cleandoc(cell).replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows
    ]
    lines = [header, tuple("---" for _ in header), *cells]
    return ["| " + " | ".join(line) + " |" for line in lines]
