"""Write a package of interfaces: definitions, the modules that make classes of them, and stubs.

The stubs (`.pyi`) describe the classes to type checkers and editors, as if they were written by
hand. Cairn's own packages are written by the same functions: after a change of the definitions,
`python -m cairn.schemas.package_files` renews their modules and stubs.
"""

import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from typing import Final

from cairn.errors import CairnError
from cairn.limits.files import read_bounded
from cairn.schemas.definitions import (
    KINDS,
    ConstantDefinition,
    DefinitionError,
    FieldDefinition,
    MessageDefinition,
    UnsupportedDefinition,
    read_definitions,
)
from cairn.schemas.interfaces import base_of, find_message, interface_names, module_name, packages
from cairn.schemas.message import Action

_IGNORED: Final = {"COLCON_IGNORE", "AMENT_IGNORE"}
_PACKAGE_NAME = re.compile("[a-z][a-z0-9_]*", re.ASCII)
_INTERFACE_NAME = re.compile("[A-Z][A-Za-z0-9]*", re.ASCII)
_NAME_IN_MANIFEST = re.compile("<name>([^<]*)</name>")
_LONGEST_MANIFEST: Final = 1 << 20

_TITLES = {"msg": "Messages", "srv": "Services", "action": "Actions"}
_TYPES = {
    "bool": "Bool",
    "byte": "Byte",
    "string": "String",
    "float32": "Float32",
    "float64": "Float64",
    **{f"int{bits}": f"Int{bits}" for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": f"UInt{bits}" for bits in (8, 16, 32, 64)},
}


@dataclass(frozen=True)
class Imported:
    """What `import_packages` has done.

    Attributes:
        written: the written folders by package.
        present: the packages that Cairn has already, each with the types that it defines otherwise.
        left_out: the types that are not supported, each with the reason.
    """

    written: dict[str, Path]
    present: dict[str, list[str]]
    left_out: dict[str, str]


def find_packages(path: Path) -> dict[str, Path]:
    """Return the folders at or below `path` that hold interface definitions, by package name.

    The name is that in the folder's package.xml, else that of the folder. As colcon does, folders
    with a file COLCON_IGNORE or AMENT_IGNORE, such as build and install in a workspace, and hidden
    ones are left out. Raises `DefinitionError` if there is none, or two of one name.
    """
    if not path.is_dir():
        raise DefinitionError(
            f"{path} is not a folder; give the folder of a ROS 2 package, which has a folder msg, "
            "srv or action, or a folder with such packages"
        )
    found: dict[str, Path] = {}
    for folder in _folders(path.resolve()):
        if not _kinds_of(folder):
            continue
        name = _package_name(folder)
        if found.setdefault(name, folder) != folder:
            raise DefinitionError(
                f"package {name} is defined twice, in {found[name]} and in {folder}; give the "
                "folder of one of them"
            )
    if not found:
        raise DefinitionError(f"{path}: there is no file msg/*.msg, srv/*.srv or action/*.action")
    return dict(sorted(found.items()))


def import_packages(path: Path, into: Path) -> Imported:
    """Write Python packages into folder `into` for the ROS 2 packages at or below `path`.

    Their definitions are copied beside the modules; those of an import before that are no longer
    defined are removed. Packages that Cairn has, and types that it does not support, are left out.
    Everything is read before anything is written. Raises `DefinitionError` if a definition is
    invalid, or refers to a type that is neither among them nor known; `CairnError` if a folder
    exists that holds something else, or cannot be written.
    """
    found = find_packages(path)
    shipped = _shipped()
    present = {
        package: _differences(package, folder, shipped[package])
        for package, folder in found.items()
        if package in shipped
    }
    sources = {name: folder for name, folder in found.items() if name not in shipped}
    defined, left_out = _read(sources)
    _check_references(defined, sources)
    module_of = _module_names(sources, into)
    files = {
        package: _files(package, _by_kind(package, defined), module_of)
        for package in sources
        if any(_by_kind(package, defined).values())
    }
    for package in files:
        target = into / package
        if target.exists() and target.resolve() != sources[package] and not _is_ours(target):
            raise CairnError(
                f"{target} exists and was not written by `cairn schema import`; remove it, or "
                "write elsewhere: --into FOLDER"
            )
    try:
        for package, modules in files.items():
            _write(sources[package], into / package, _by_kind(package, defined), modules)
    except OSError as error:
        raise CairnError(f"{into} cannot be written: {error.strerror or error}") from error
    return Imported({package: into / package for package in files}, present, left_out)


def module_files(package: str, folder: Path) -> dict[str, str]:
    """Return the text of the modules and stubs of one of Cairn's packages, by relative path."""
    defined = {
        kind: {
            name: read_definitions(folder / kind / f"{name}.{kind}", f"{package}/{kind}/{name}")
            for name in interface_names(folder, kind)
        }
        for kind in KINDS
    }
    files = _files(package, defined, module_name)
    if not _is_ours(folder):  # has classes written by hand
        del files["__init__.py"]
    return files


_Defined = Mapping[str, MessageDefinition]
"""What one file defines, by full name."""

_ByKind = Mapping[str, Mapping[str, _Defined]]
"""What a package defines, by kind and name."""


def _folders(path: Path) -> Iterator[Path]:
    """Yield a folder and those below it that may be packages."""
    for place, inner, files in os.walk(path):
        folder = Path(place)
        if folder != path and not _IGNORED.isdisjoint(files):
            inner.clear()
            continue
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        yield folder


def _package_name(folder: Path) -> str:
    name = folder.name
    manifest = folder / "package.xml"
    if manifest.is_file():
        match = _NAME_IN_MANIFEST.search(read_bounded(manifest, _LONGEST_MANIFEST).decode())
        name = match[1].strip() if match else name
    if not _PACKAGE_NAME.fullmatch(name) or iskeyword(name):
        raise DefinitionError(
            f"{folder}: {name[:100]!r} is not the name of a ROS 2 package, such as my_msgs"
        )
    return name


def _read(sources: Mapping[str, Path]) -> tuple[dict[str, _Defined], dict[str, str]]:
    """Return what the files of packages define, by full name; and what is not supported."""
    defined: dict[str, _Defined] = {}
    left_out: dict[str, str] = {}
    for package, folder in sources.items():
        for kind in KINDS:
            for name in interface_names(folder, kind):
                file, full = folder / kind / f"{name}.{kind}", f"{package}/{kind}/{name}"
                if not _INTERFACE_NAME.fullmatch(name) or iskeyword(name):
                    raise DefinitionError(
                        f"{file}: {name[:100]!r} is not the name of an interface, such as MyStatus"
                    )
                try:
                    defined[full] = read_definitions(file, full)
                except UnsupportedDefinition as error:
                    left_out[full] = str(error)
    while lost := {
        full: f"{full} contains {one.element}, which is left out"
        for full, definitions in defined.items()
        for one in _references(definitions)
        if one.element in left_out
    }:
        left_out |= lost
        for full in lost:
            del defined[full]
    return defined, left_out


def _references(defined: _Defined) -> Iterator[FieldDefinition]:
    """Yield the fields of a file that are messages of another file, or the message itself."""
    for message in defined.values():
        for one in message.fields:
            if "/" in one.element and (one.element not in defined or one.element == message.name):
                yield one


def _check_references(defined: Mapping[str, _Defined], sources: Mapping[str, Path]) -> None:
    """Raise `DefinitionError` if a type is not defined, or contains itself."""
    graph: dict[str, set[str]] = {}
    for full, definitions in defined.items():
        graph[full] = set()
        for one in _references(definitions):
            package = one.element.split("/")[0]
            graph[full].add(one.element)
            if one.element in defined or (package not in sources and find_message(one.element)):
                continue
            _, kind, name = full.split("/")
            file = sources[full.split("/")[0]] / kind / f"{name}.{kind}"
            remedy = (
                "correct its name, or define it"
                if package in sources or package in packages()
                else f"import package {package} together with it, from a folder that holds both"
            )
            raise DefinitionError(
                f"{file}:{one.line}: field {one.name}: there is no message {one.element}; {remedy}"
            )
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        chain = " contains ".join(reversed(error.args[1]))
        raise DefinitionError(f"a message contains itself: {chain}") from error


def _differences(package: str, folder: Path, own: Path) -> list[str]:
    """Return the types that the two folders of a package define differently, or only the first."""
    found = []
    for kind in KINDS:
        for name in interface_names(folder, kind):
            full, relative = f"{package}/{kind}/{name}", f"{kind}/{name}.{kind}"
            try:
                if read_definitions(folder / relative, full) != read_definitions(
                    own / relative, full
                ):
                    found.append(full)
            except DefinitionError:
                found.append(full)
    return found


def _by_kind(package: str, defined: Mapping[str, _Defined]) -> dict[str, dict[str, _Defined]]:
    return {
        kind: {
            full.rpartition("/")[2]: one
            for full, one in defined.items()
            if full.startswith(f"{package}/{kind}/")
        }
        for kind in KINDS
    }


def _write(source: Path, target: Path, defined: _ByKind, modules: Mapping[str, str]) -> None:
    """Write a package; remove what an import before has left."""
    for kind, names in defined.items():
        folder = target / kind
        if names:
            folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            original, copy = source / kind / f"{name}.{kind}", folder / f"{name}.{kind}"
            if original != copy.resolve():
                copy.write_bytes(original.read_bytes())
        if target.resolve() == source:
            continue
        for old in interface_names(target, kind):
            if old not in names:
                (folder / f"{old}.{kind}").unlink()
        if not names:
            for file in ("__init__.py", "__init__.pyi"):
                (folder / file).unlink(missing_ok=True)
            shutil.rmtree(folder / "__pycache__", ignore_errors=True)
            if folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
    for relative, text in modules.items():
        (target / relative).write_text(text, encoding="utf-8")


def _files(package: str, defined: _ByKind, module_of: Callable[[str], str]) -> dict[str, str]:
    files = {"__init__.py": f'"""{_package_title(package)}"""\n'}
    for kind, names in defined.items():
        if not names:
            continue
        title = f'"""{_TITLES[kind]} of ROS 2 package {package}.'
        files[f"{kind}/__init__.py"] = (
            f'{title}\n\nTheir classes are made of the files beside this one.\n"""\n\n'
            "from cairn.schemas.interfaces import package_of\n\n"
            "__getattr__, __dir__ = package_of(__name__)\n"
        )
        files[f"{kind}/__init__.pyi"] = f'{title}"""\n\n{_stub(package, kind, names, module_of)}'
    return files


def _stub(
    package: str, kind: str, names: Mapping[str, _Defined], module_of: Callable[[str], str]
) -> str:
    by_hand = set(_classes_by_hand(package, kind)) if package in _shipped() else set()
    imported: set[str] = set()
    used: set[str] = set()
    classes: list[str] = []
    for name, defined in names.items():
        if name in by_hand:
            classes.append(f"from {module_of(package)} import {name} as {name}")
            continue
        classes += [_class(one, defined, package, kind, imported, used) for one in defined.values()]
    typing = [name for name in ("ClassVar", "TypeAlias") if any(name in one for one in classes)]
    head = [f"from typing import {', '.join(typing)}", ""] if typing else []
    modules = {other: f"from {module_of(other)} import msg as {other}" for other in imported}
    if "field_types" in used:
        head.append("from cairn.schemas import field_types")
    if names_used := sorted(used - {"field_types"}):
        modules["message"] = f"from cairn.schemas.message import {', '.join(names_used)}"
    head += [line for _, line in sorted(modules.items())]
    return "\n".join(head) + "\n\n" + "\n\n".join(classes) + "\n"


def _class(
    one: MessageDefinition,
    defined: Mapping[str, MessageDefinition],
    package: str,
    kind: str,
    imported: set[str],
    used: set[str],
) -> str:
    """Return the text of a class; add to `imported` and `used` what it needs."""
    name = one.name.split("/")[2]
    parts = dict(_parts_of(one.name, defined))
    base = base_of(one.name, defined)
    if base is not None:
        used.add(base.__name__)
        arguments = ("Goal", "Result", "Feedback") if base is Action else ("Request", "Response")
        head = f"class {name}({base.__name__}[{', '.join(parts[part] for part in arguments)}]):"
        aliases = [f"    {attribute}: TypeAlias = {part}" for attribute, part in parts.items()]
        return "\n".join([head, *aliases])
    used.add("message")
    lines = [f'@message("{one.name}")', f"class {name}:"]
    lines += [
        f"    {constant.name}: ClassVar[{_type(constant, used)}] = ..."
        for constant in one.constants
    ]
    lines += [
        f"    {field.name}: {_field_type(field, package, kind, imported, used)} = ..."
        for field in one.fields
    ]
    return "\n".join(lines)


def _parts_of(name: str, defined: Mapping[str, MessageDefinition]) -> Iterator[tuple[str, str]]:
    """Yield the attributes of a class that are other classes, such as Request: Trigger_Request."""
    for part in defined:
        whole, _, attribute = part.rpartition("_")
        if whole == name:
            yield attribute, part.split("/")[2]


def _field_type(
    field: FieldDefinition, package: str, kind: str, imported: set[str], used: set[str]
) -> str:
    if "/" not in field.element:
        return _type(field, used)
    other, other_kind, name = field.element.split("/")
    if (other, other_kind) == (package, kind) or other_kind != "msg":
        one = name
    else:
        imported.add(other)
        one = f"{other}.{name}"
    return one if field.count is None else f"tuple[{one}, ...]"


def _type(one: FieldDefinition | ConstantDefinition, used: set[str]) -> str:
    used.add("field_types")  # as a module: std_msgs has classes with the names of its types
    name = f"field_types.{_TYPES[one.element]}"
    if isinstance(one, FieldDefinition) and one.count is not None:
        if one.element == "string":
            return f"tuple[{name}, ...]"
        return f"{'field_types.UInt8' if one.element == 'byte' else name}Array"
    return name


def _kinds_of(folder: Path) -> list[str]:
    return [kind for kind in KINDS if interface_names(folder, kind)]


def _package_title(package: str) -> str:
    return f"ROS 2 package {package}: its interfaces are in msg, srv and action."


def _is_ours(folder: Path) -> bool:
    module = folder / "__init__.py"
    return module.is_file() and _package_title(folder.name) in module.read_text(encoding="utf-8")


def _shipped() -> dict[str, Path]:
    own = Path(__file__).parent
    return {name: folder for name, folder in packages().items() if folder.parent == own}


def _module_names(found: Mapping[str, Path], into: Path) -> Callable[[str], str]:
    """Return a function from a package's name to its module, as stubs in `into` import it."""
    # `...` is the Python package of which `into` is the folder.
    prefix = "..." if (into / "__init__.py").exists() else ""

    def module_of(package: str) -> str:
        return f"{prefix}{package}" if package in found else module_name(package)

    return module_of


def _classes_by_hand(package: str, kind: str) -> Iterator[str]:
    for name, value in vars(import_module(f"cairn.schemas.{package}")).items():
        if isinstance(value, type) and value.__dict__.get("__ros_type__") == (
            f"{package}/{kind}/{name}"
        ):
            yield name


def main() -> None:
    """Renew the modules and stubs of Cairn's own packages."""
    for package, folder in _shipped().items():
        for relative, text in module_files(package, folder).items():
            (folder / relative).write_text(text)
    sys.stdout.write(f"{len(_shipped())} packages\n")


if __name__ == "__main__":
    main()
