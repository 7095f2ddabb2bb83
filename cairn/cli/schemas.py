"""`cairn schema`: the types of messages, services and actions; import and export of definitions."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cairn.bus.type_hash import own_definition, type_description, type_hash
from cairn.cli.schema_export import export_definitions
from cairn.deployment.message_types import find_type, messages_of_plugins
from cairn.deployment.problems import suggestion
from cairn.errors import CairnError
from cairn.schemas.definitions import KINDS, DefinitionError
from cairn.schemas.interfaces import (
    ENTRY_POINTS,
    interface,
    interface_names,
    interface_type_names,
    module_name,
    packages,
)
from cairn.schemas.message import Action, Service, classes_in, type_name
from cairn.schemas.package_files import Imported, import_packages
from cairn.terminal.completion import interface_types
from cairn.terminal.options import Json
from cairn.terminal.output import line, note, print_json, show

_SEPARATOR = "=" * 80
_KIND_TITLES = {"msg": "message", "srv": "service", "action": "action"}

schema = typer.Typer(help="List, show, import and export the ROS 2 types.")


@schema.command("list")
def list_types(
    package: Annotated[
        str, typer.Argument(metavar="PACKAGE", help="Only those of this package, as in nav2_msgs.")
    ] = "",
    hashes: Annotated[bool, typer.Option("--hash", help="Print their type hashes, too.")] = False,
    json: Json = False,
) -> None:
    """List the types of messages, services and actions, and where Python imports them.

    They are those of ROS 2 and of Cairn, those of imported packages, and those of the ports of
    installed plugins.
    """
    of_plugins = messages_of_plugins()
    names = sorted({*interface_type_names(), *of_plugins})
    known_packages = sorted({name.partition("/")[0] for name in names})
    if package and package not in known_packages:
        raise CairnError(f"there is no package {package}; {suggestion(package, known_packages)}")
    rows = []
    for name in names:
        ros_package, kind, _ = name.split("/")
        if package not in ("", ros_package):
            continue
        row = {"type": name, "kind": _KIND_TITLES[kind], "module": _module(name, of_plugins)}
        if hashes or json:
            valid = _valid(name, of_plugins)
            row["hash"] = "invalid" if valid is None else type_hash(valid)
        rows.append(row)
    columns = ("type", "hash") if hashes else ("type", "module")
    show(rows, columns, as_json=json)


@schema.command("show")
def show_type(
    name: Annotated[
        str,
        typer.Argument(
            metavar="TYPE",
            help="As in nav_msgs/msg/Odometry, std_srvs/srv/Trigger or nav2_msgs/action/Spin.",
            autocompletion=interface_types,
        ),
    ],
    json: Json = False,
) -> None:
    """Print the definition of a type, with those of the types in it, and its type hash."""
    found = find_type(name)
    full = type_name(found)
    text = _text(found)
    if json:
        print_json(
            {
                "type": full,
                "hash": type_hash(found),
                "definition": text,
                "description": type_description(found),
            }
        )
        return
    line(f"# {full}\n# {type_hash(found)}\n{text.rstrip()}")


@schema.command("import")
def import_types(
    path: Annotated[
        Path,
        typer.Argument(
            help="Folder of a ROS 2 package, of a workspace, or an ament `share` folder.",
            metavar="PATH",
        ),
    ],
    into: Annotated[
        Path, typer.Option(help="Folder of the written packages.", metavar="FOLDER")
    ] = Path(),
) -> None:
    """Make Python packages of ROS 2 definitions (.msg, .srv, .action), with stubs for editors.

    Import again after a change of the definitions: the packages are renewed.
    """
    imported = import_packages(path, into)
    for package, differing in imported.present.items():
        but = f"; its own definition remains for {', '.join(differing)}" if differing else ""
        note(f"left out {package}: it is part of Cairn already{but}")
    for name, reason in imported.left_out.items():
        note(f"left out {name}: {reason}")
    if not imported.written:
        raise CairnError(f"{path}: nothing was imported; the lines above give the reasons")
    _print_written(imported)


@schema.command("export")
def export_types(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Is made if it is missing.")],
) -> None:
    """Write the definitions of all types as an installation of ROS 2 has them.

    For tools that read the folders of AMENT_PREFIX_PATH: each package gets its folder in
    FOLDER/share, with definitions, type descriptions (.json) and package.xml.
    """
    of_plugins = messages_of_plugins()
    names = sorted({*interface_type_names(), *of_plugins})
    types = {name: found for name in names if (found := _valid(name, of_plugins)) is not None}
    count = export_definitions(types, folder)
    line(f"wrote {len(types)} types of {count} packages; for tools that read them:")
    line(f"export AMENT_PREFIX_PATH={folder.resolve()}")


def _valid(name: str, of_plugins: dict[str, type[Any]]) -> type[Any] | None:
    """Return the class of a type; if its definition is invalid, print that and return None."""
    try:
        return of_plugins.get(name) or interface(name)
    except DefinitionError as error:
        note(f"left out {name}: {error}")
        return None


def _module(name: str, of_plugins: dict[str, type[Any]]) -> str:
    """Return the module from which a type is imported."""
    if name in of_plugins:
        return of_plugins[name].__module__
    package, kind, _ = name.split("/")
    if package in packages():
        return f"{module_name(package)}.{kind}"
    return interface(name).__module__


def _text(found: type[Any]) -> str:
    """Return the definition of a type, followed by those of the messages in it."""
    parts: tuple[type[Any], ...] = (found,)
    if issubclass(found, Service):
        parts = (found.Request, found.Response)
    elif issubclass(found, Action):
        parts = (found.Goal, found.Result, found.Feedback)
    inner = dict.fromkeys(one for part in parts for one in classes_in(part))
    others = [one for one in inner if one not in parts]
    texts = [_own_text(found)]
    texts += [f"MSG: {type_name(one).replace('/msg/', '/')}\n{_own_text(one)}" for one in others]
    return f"{_SEPARATOR}\n".join(texts)


def _own_text(found: type[Any]) -> str:
    """Return the file of a type with its comments; without a file, its definition."""
    package, kind, name = type_name(found).split("/")
    folder = packages().get(package)
    file = folder / kind / f"{name}.{kind}" if folder is not None else None
    if file is not None and file.is_file():
        text = file.read_text(encoding="utf-8")
        return text if text.endswith("\n") or not text else f"{text}\n"
    return own_definition(found)


def _print_written(imported: Imported) -> None:
    modules = {package: _module_of(folder) for package, folder in imported.written.items()}
    for folder in imported.written.values():
        counts = {kind: len(interface_names(folder, kind)) for kind in KINDS}
        what = ", ".join(
            f"{count} {_KIND_TITLES[kind]}{'s' if count > 1 else ''}"
            for kind, count in counts.items()
            if count
        )
        line(f"wrote {folder}: {what}")
    package, folder = next(iter(imported.written.items()))
    kind = next(kind for kind in KINDS if interface_names(folder, kind))
    line("\nImport them as in:")
    line(f"    from {modules[package]}.{kind} import {interface_names(folder, kind)[0]}")
    line("\nFor `cairn topic`, `cairn schema` and recordings, add to pyproject.toml:")
    line(f'    [project.entry-points."{ENTRY_POINTS}"]')
    for name, module in modules.items():
        line(f'    {name} = "{module}"')
    line("and install the project again.")


def _module_of(folder: Path) -> str:
    """Return the name by which Python imports a folder, from the outermost package around it."""
    folder = folder.resolve()
    names = [folder.name]
    while (folder.parent / "__init__.py").is_file():
        folder = folder.parent
        names.append(folder.name)
    return ".".join(reversed(names))
