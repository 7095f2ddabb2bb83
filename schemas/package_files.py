"""Write a package of interfaces: definitions, the modules that make classes of them, and stubs.

The stubs (`.pyi`) describe the classes to type checkers and editors, as if they were written by
hand. Cairn's own packages are written by the same functions: after a change of the definitions,
`python -m cairn.schemas.package_files` renews their modules and stubs.
"""

import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path

from cairn.errors import CairnError
from cairn.schemas.definitions import (
    KINDS,
    ConstantDefinition,
    DefinitionError,
    FieldDefinition,
    MessageDefinition,
    read_definitions,
)
from cairn.schemas.interfaces import base_of, interface_names, module_name, packages
from cairn.schemas.message import Action

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


def find_packages(path: Path) -> dict[str, Path]:
    """Return the folders at or below `path` that hold interface definitions, by package name.

    The name is that of the folder, as in a workspace of ROS 2. Raises `DefinitionError` if there is
    none, or two of one name.
    """
    if not path.is_dir():
        raise DefinitionError(
            f"{path} is not a folder; give the folder of a ROS 2 package, which has a folder msg, "
            "srv or action, or a folder with such packages"
        )
    found: dict[str, Path] = {}
    for kind in KINDS:
        for file in sorted(path.resolve().rglob(f"{kind}/*.{kind}")):
            folder = file.parent.parent
            if found.setdefault(folder.name, folder) != folder:
                raise DefinitionError(
                    f"package {folder.name} is defined twice, in {found[folder.name]} and in "
                    f"{folder}; give the folder of one of them"
                )
    if not found:
        raise DefinitionError(f"{path}: there is no file msg/*.msg, srv/*.srv or action/*.action")
    return dict(sorted(found.items()))


def import_packages(path: Path, into: Path) -> dict[str, Path]:
    """Write Python packages into folder `into` for the ROS 2 packages at or below `path`.

    Their definitions are copied beside the modules. Returns the written folders by package.
    Everything is read before anything is written. Raises `DefinitionError` if a definition is
    invalid, or refers to a package that is neither among them nor known; `CairnError` if a folder
    exists that holds something else.
    """
    found = find_packages(path)
    for package in found:
        if package in _shipped():
            raise DefinitionError(f"package {package} is part of Cairn already")
    module_of = _module_names(found, into)
    files = {package: _files(package, folder, module_of) for package, folder in found.items()}
    for package, folder in found.items():
        target = into / package
        if target.exists() and target.resolve() != folder and not _is_written_by_us(target):
            raise CairnError(
                f"{target} exists and was not written by `cairn schema import`; remove it, or "
                "write elsewhere: --into FOLDER"
            )
    for package, folder in found.items():
        target = into / package
        for kind in _kinds_of(folder):
            (target / kind).mkdir(parents=True, exist_ok=True)
            for name in interface_names(folder, kind):
                source, copy = folder / kind / f"{name}.{kind}", target / kind / f"{name}.{kind}"
                if source != copy.resolve():
                    shutil.copyfile(source, copy)
        for relative, text in files[package].items():
            (target / relative).write_text(text)
    return {package: into / package for package in found}


def module_files(package: str, folder: Path) -> dict[str, str]:
    """Return the text of the modules and stubs of one of Cairn's packages, by relative path."""
    return _files(package, folder, module_name)


def _files(package: str, folder: Path, module_of: Callable[[str], str]) -> dict[str, str]:
    files = {}
    if not (folder / "__init__.py").exists() or _is_written_by_us(folder):
        files["__init__.py"] = f'"""{_package_title(package)}"""\n'
    for kind in _kinds_of(folder):
        title = f'"""{_TITLES[kind]} of ROS 2 package {package}.'
        files[f"{kind}/__init__.py"] = (
            f'{title}\n\nTheir classes are made of the files beside this one.\n"""\n\n'
            "from cairn.schemas.interfaces import package_of\n\n"
            "__getattr__, __dir__ = package_of(__name__)\n"
        )
        stub = _stub(package, folder, kind, module_of)
        files[f"{kind}/__init__.pyi"] = f'{title}"""\n\n{stub}'
    return files


def _stub(package: str, folder: Path, kind: str, module_of: Callable[[str], str]) -> str:
    by_hand = set(_classes_by_hand(package, kind)) if package in _shipped() else set()
    imported: set[str] = set()
    used: set[str] = set()
    classes: list[str] = []
    for name in interface_names(folder, kind):
        if name in by_hand:
            classes.append(f"from {module_of(package)} import {name} as {name}")
            continue
        full = f"{package}/{kind}/{name}"
        defined = read_definitions(folder / kind / f"{name}.{kind}", full)
        classes += [_class(one, defined, package, kind, imported, used) for one in defined.values()]
    typing = [name for name in ("ClassVar", "TypeAlias") if any(name in one for one in classes)]
    head = [f"from typing import {', '.join(typing)}", ""] if typing else []
    modules = {other: f"from {module_of(other)} import msg as {other}" for other in imported}
    if "field_types" in used:
        head.append("from cairn.schemas import field_types")
    if names := sorted(used - {"field_types"}):
        modules["message"] = f"from cairn.schemas.message import {', '.join(names)}"
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


def _is_written_by_us(folder: Path) -> bool:
    module = folder / "__init__.py"
    return module.is_file() and _package_title(folder.name) in module.read_text()


def _shipped() -> dict[str, Path]:
    own = Path(__file__).parent
    return {name: folder for name, folder in packages().items() if folder.parent == own}


def _module_names(found: Mapping[str, Path], into: Path) -> Callable[[str], str]:
    """Return a function from a package's name to its module, as stubs in `into` import it."""
    # `...` is the Python package of which `into` is the folder.
    prefix = "..." if (into / "__init__.py").exists() else ""

    def module_of(package: str) -> str:
        if package in found:
            return f"{prefix}{package}"
        if package in packages():
            return module_name(package)
        raise DefinitionError(
            f"there is no package {package}, which the definitions refer to; import it together "
            "with them, from a folder that holds both"
        )

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
