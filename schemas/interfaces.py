"""Classes of ROS 2 interfaces by name, made of their definitions when they are asked for.

A package of interfaces is a Python package with the folders `msg`, `srv` and `action`, which hold
the files of ROS 2 beside a module that imports from here:

    from cairn.schemas.nav2_msgs.action import NavigateToPose
    from cairn.schemas.std_srvs.srv import Trigger

`cairn schema import` makes such a package of other definitions. Where Cairn has a class written by
hand, which validates more, this is the class that all definitions refer to.
"""

import logging
import sys
import threading
from collections.abc import Callable, Collection
from dataclasses import field
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from cairn.schemas.definitions import (
    KINDS,
    DefinitionError,
    FieldDefinition,
    MessageDefinition,
    full_type_name,
    read_definitions,
)
from cairn.schemas.field_types import Array, Scalar, Several, Text
from cairn.schemas.message import (
    Action,
    Service,
    composed_type,
    message,
    schema_messages,
    type_name,
)

ENTRY_POINTS: Final = "cairn.messages"
"""Entry point group of packages of interfaces: the package's name in ROS 2 = its module."""

_MOST_NESTED: Final = 100
"""Most types within each other; Python's stack has room for about three times as many."""

_OWN: Final = Path(__file__).parent

_PYTHON_TYPES = {"bool": bool, "float32": float, "float64": float, "string": str}


def interface(name: str) -> type[Any]:
    """Return the class of a message, service or action by its name in ROS 2.

    `std_msgs/msg/String`, also `std_msgs/String`; `std_srvs/srv/Trigger`, whose parts are
    `Trigger.Request`, `.Response` and `.Event`; `nav2_msgs/action/Spin`, whose parts are
    `Spin.Goal`, `.Result`, `.Feedback`, and what implements it: `.SendGoal`, `.GetResult` (two
    services) and `.FeedbackMessage`. Raises `DefinitionError` if it is not defined, or wrongly.
    """
    return _registry.interface(full_type_name(name))


def find_message(name: str) -> type[Any] | None:
    """Return the message class of a full name; None if it is not that of a valid message type."""
    try:
        found = interface(name)
    except DefinitionError:
        return None
    is_message = not issubclass(found, Service | Action)
    return found if is_message and type_name(found) == name else None


def interface_type_names() -> list[str]:
    """Return the full names of all known messages, services and actions, sorted.

    Of a service or action, its parts are not among them.
    """
    names = {name for name in schema_messages() if name.startswith("cairn_")}
    for package, folder in packages().items():
        for kind in KINDS:
            names |= {f"{package}/{kind}/{name}" for name in interface_names(folder, kind)}
    return sorted(names)


def package_of(module: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of the module `msg`, `srv` or `action` of a package.

    `module` is its `__name__`: "cairn.schemas.nav2_msgs.action".
    """
    package, _, kind = module.rpartition(".")
    ros_package = package.rpartition(".")[2]
    folder = _registry.add(ros_package, package)

    def get(name: str) -> Any:
        if not (folder / kind / f"{name}.{kind}").is_file():
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return interface(f"{ros_package}/{kind}/{name}")

    def names() -> list[str]:
        return interface_names(folder, kind)

    return get, names


def interface_names(folder: Path, kind: str) -> list[str]:
    """Return the names of the interfaces of a kind that a package's folder defines, sorted."""
    return sorted(file.stem for file in (folder / kind).glob(f"*.{kind}"))


def packages() -> dict[str, Path]:
    """Return the folders of all known packages of interfaces, by their names in ROS 2.

    They are those of Cairn, those of the entry point group `cairn.messages`, and those that were
    imported before. A package that cannot be imported is left out, and logged.
    """
    return _registry.packages()


def module_name(package: str) -> str:
    """Return the name of the Python module of a known package."""
    return _registry.module_name(package)


@cache
def _entry_points() -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=ENTRY_POINTS))


class _Registry:
    """The packages of interfaces of this process, and the classes made so far."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._classes: dict[str, type[Any]] = {}
        self._modules: dict[str, str] = {}  # by package in ROS 2
        self._folders: dict[str, Path] = {}
        self._making: set[str] = set()
        for folder in _OWN.iterdir():
            if any((folder / kind).is_dir() for kind in KINDS):
                self._folders[folder.name] = folder
                self._modules[folder.name] = f"{__package__}.{folder.name}"

    def add(self, ros_package: str, module: str) -> Path:
        """Add a package that is imported as `module`; return its folder."""
        places = list(getattr(sys.modules[module], "__path__", ()))
        if not places:
            raise DefinitionError(
                f"{module}, which should hold the interfaces of {ros_package}, is not a package; "
                f"correct the entry point in the group {ENTRY_POINTS}"
            )
        folder = Path(places[0])
        with self._lock:
            known = self._modules.setdefault(ros_package, module)
            if known != module:
                raise DefinitionError(
                    f"the interfaces of {ros_package} are defined twice, by {known} and by "
                    f"{module}; import one of them everywhere"
                )
            self._folders[ros_package] = folder
        return folder

    def packages(self) -> dict[str, Path]:
        """Return the folders of all packages, by name."""
        with self._lock:
            for point in _entry_points():
                try:
                    self._load(point.name)
                except DefinitionError as error:
                    _log.warning("package of interfaces left out: %s", error)
            return dict(sorted(self._folders.items()))

    def module_name(self, package: str) -> str:
        """Return the name of a package's Python module."""
        return self._modules[package]

    def interface(self, name: str) -> type[Any]:
        """Return the class of a full name, made now if need be."""
        found = self._classes.get(name)
        if found is None:
            with self._lock:
                found = self._classes.get(name) or self._make(name)
        return found

    def _make(self, name: str) -> type[Any]:
        ros_package, kind, last = name.split("/")
        self._load(ros_package)
        own_module = self._modules.get(ros_package)
        if own_module is None and (_OWN / f"{ros_package}.py").is_file():
            own_module = f"{__package__}.{ros_package}"  # without definitions, such as cairn_msgs
        own = own_module and getattr(import_module(own_module), last, None)
        if isinstance(own, type) and own.__dict__.get("__ros_type__") == name:
            self._classes[name] = own
            return own
        if ros_package not in self._folders:
            raise DefinitionError(
                f"{name}: there is no package {ros_package}; import its definitions by `cairn "
                f"schema import FOLDER`, and name it in the entry point group {ENTRY_POINTS}"
            )
        stem = last.partition("_")[0]  # Spin.action defines Spin_SendGoal_Request
        path = self._folders[ros_package] / kind / f"{stem}.{kind}"
        if not path.is_file():
            raise DefinitionError(f"{name}: {path} is missing, which would define it")
        defined = read_definitions(path, f"{ros_package}/{kind}/{stem}")
        if name not in defined:
            raise DefinitionError(f"{name}: {path} does not define it")
        if not self._making.isdisjoint(defined):
            raise DefinitionError(f"{path}: {stem} contains itself")
        if len(self._making) > _MOST_NESTED:
            raise DefinitionError(f"{path}: nested in more than {_MOST_NESTED} other types")
        self._making.update(defined)
        made: dict[str, type[Any]] = {}
        try:
            for one in defined.values():
                made[one.name] = self._class(one, made, defined)
        finally:
            self._making.difference_update(defined)
        for part in made:  # Spin_SendGoal_Request is Spin.SendGoal.Request
            whole, _, attribute = part.rpartition("_")
            if whole in made:
                setattr(made[whole], attribute, made[part])
        self._classes.update(made)
        return made[name]

    def _load(self, ros_package: str) -> None:
        """Find a package of the entry points, or beside one that is known, unless that is done."""
        if ros_package in self._folders:
            return
        for known, folder in list(self._folders.items()):
            beside = folder.parent / ros_package
            if any((beside / kind).is_dir() for kind in KINDS):
                prefix = self._modules[known].removesuffix(known)
                self.add(ros_package, import_module(f"{prefix}{ros_package}").__name__)
                return
        for point in _entry_points():
            if point.name != ros_package:
                continue
            try:
                module = import_module(point.value)
            except Exception as error:  # a package's module may fail in any way
                raise DefinitionError(
                    f"entry point {ENTRY_POINTS}: {point.name} = {point.value} cannot be "
                    f"imported: {error!r}; correct the package that provides it, or uninstall it"
                ) from error
            self.add(ros_package, module.__name__)

    def _class(
        self,
        definition: MessageDefinition,
        made: dict[str, type[Any]],
        defined: dict[str, MessageDefinition],
    ) -> type[Any]:
        """Return the class of a definition; `made` has those of the same file before it."""
        name = definition.name
        ros_package, kind, last = name.split("/")
        namespace: dict[str, Any] = {
            "__module__": f"{self._modules[ros_package]}.{kind}",
            "__qualname__": last.replace("_", "."),
            "__doc__": f"ROS 2 type {name}.",
        }
        base = base_of(name, defined)
        if base is not None:
            parts = {one.name: made[one.element] for one in definition.fields}
            return composed_type(base, name, parts, namespace)
        namespace["__annotations__"] = {}
        annotations = namespace["__annotations__"]
        for constant in definition.constants:
            annotations[constant.name] = ClassVar[_primitive(constant.element, None)]
            namespace[constant.name] = constant.value
        for one in definition.fields:
            annotations[one.name], namespace[one.name] = self._field(one, made)
        return message(name)(type(last, (), namespace))

    def _field(self, one: FieldDefinition, made: dict[str, type[Any]]) -> tuple[Any, Any]:
        """Return the annotation of a field, and its default."""
        if "/" in one.element:
            element = made.get(one.element) or self.interface(one.element)
            if one.count is None:
                return element, field(default_factory=element)
            many = _many(element, one)
            return many, () if not one.count else field(default_factory=_repeated(element, one))
        if one.count is None:
            default = _PYTHON_TYPES.get(one.element, int)() if one.default is None else one.default
            return _primitive(one.element, one.text_most), default
        if one.element == "string":
            many = _many(_primitive("string", one.text_most), one)
            return many, one.default or ("",) * one.count
        dtype = np.dtype("uint8" if one.element == "byte" else one.element)
        mark = Array(one.element, length=one.count or None, most=one.most)
        values = np.array(one.default or np.zeros(one.count), dtype)
        values.flags.writeable = False
        return Annotated[npt.NDArray[Any], mark], field(default_factory=lambda: values)


def base_of(name: str, defined: Collection[str]) -> type[Any] | None:
    """Return `Service` or `Action` if `name` is one among the types that a file defines."""
    if f"{name}_Event" in defined:
        return Service
    return Action if f"{name}_FeedbackMessage" in defined else None


def _primitive(element: str, text_most: int | None) -> Any:
    if element == "string":
        return Annotated[str, Text(most=text_most)]
    return Annotated[_PYTHON_TYPES.get(element, int), Scalar(element)]


def _many(element: Any, one: FieldDefinition) -> Any:
    several = tuple[element, ...]
    if not one.count and one.most is None:
        return several
    return Annotated[several, Several(length=one.count or None, most=one.most)]


def _repeated(element: type[Any], one: FieldDefinition) -> Callable[[], tuple[Any, ...]]:
    return lambda: (element(),) * (one.count or 0)


_log = logging.getLogger("cairn.schemas")

_registry: Final = _Registry()
