"""Groups of commands that are imported only when they are invoked; the groups of devices.

Typer imports all commands; Click's documentation shows lazy groups as a recipe, not as a class.
"""

from __future__ import annotations

import gc
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from cairn.errors import CairnError

_OF_OTHER_PACKAGES = "Installed by other packages"
_MAX_CHOICES = 50  # for a missing argument


@dataclass(frozen=True)
class LazyCommand:
    """A command that a group lists without importing its implementation.

    Attributes:
        name: as typed.
        target: `package.module:attribute`, a `typer.Typer` or a function as typer takes it.
        summary: one line for the group's help; None if only the implementation knows it.
        section: heading under which the group's help lists the command.
        negative_numbers: whether arguments may begin with a minus, as coordinates do.
    """

    name: str
    target: str
    summary: str | None = None
    section: str = "Commands"
    negative_numbers: bool = False

    def load(self) -> Any:
        """Import the implementation and return it as a command of the command-line library."""
        gc.disable()  # searching what is imported for garbage takes a fifth of the whole time
        try:
            found = resolve_name(self.target)
        finally:
            gc.freeze()  # nor is it searched later
            gc.enable()
        holder = typer.Typer(rich_markup_mode=None, add_completion=False)
        holder.callback()(_no_options)  # without it, a single command would replace its group
        if isinstance(found, typer.Typer):
            lazy = getattr(found.info, "cls", None)
            is_lazy = isinstance(lazy, type) and issubclass(lazy, _LazyGroup)
            cls = lazy if is_lazy else _Group
            holder.add_typer(found, name=self.name, cls=cls, no_args_is_help=True)
        else:
            settings = {"ignore_unknown_options": True} if self.negative_numbers else {}
            holder.command(self.name, context_settings=settings)(found)
        group: Any = typer.main.get_command(holder)
        return group.commands[self.name]


def lazy_group(
    own: Iterable[LazyCommand] = (),
    *,
    entry_points: str,
    kind: str = "command",
    packages: Mapping[str, str] | None = None,
    negative_numbers: bool = False,
) -> type[TyperGroup]:
    """Return the class of a group that has its own commands and those of installed packages.

    Args:
        own: the group's own commands, in the order in which its help lists them.
        entry_points: group of entry points by which installed packages add commands.
        kind: what such an entry is called in error messages.
        packages: which package has a command that is well known and may not be installed.
        negative_numbers: whether arguments of the added commands may begin with a minus.
    """

    class Group(_LazyGroup):
        _own = {command.name: command for command in own}
        _entry_points = entry_points
        _kind = kind
        _packages = packages or {}
        _negative_numbers = negative_numbers

    return Group


class _Group(TyperGroup):
    """A group whose help has the whole summary of each command."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with the first paragraphs of their help."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl([(name, _first_paragraph(command)) for name, command in commands])


class _LazyGroup(TyperGroup):
    _own: dict[str, LazyCommand]
    _entry_points: str
    _kind: str
    _packages: Mapping[str, str]
    _negative_numbers: bool

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        # The library suggests these names for a mistyped one; `get_command` loads the commands.
        self.commands = {
            name: TyperCommand(name, help=command.summary) for name, command in self._own.items()
        }
        self._only_names = False  # are needed, so that nothing has to be imported

    def list_commands(self, _: Any) -> list[str]:
        """Return the names of all commands."""
        return [command.name for command in self._all()]

    def get_command(self, _: Any, cmd_name: str) -> Any:
        """Import the command of this name; None if there is none, `CairnError` if it is broken."""
        command = self._own.get(cmd_name) or self._installed().get(cmd_name)
        if command is None:
            if package := self._packages.get(cmd_name):
                raise CairnError(
                    f"the package {package} has the command {cmd_name}; `pip install {package}`, "
                    "or `pip install ./lab` in a checkout"
                )
            return None
        if self._only_names:
            return TyperCommand(cmd_name, help=command.summary)
        try:
            return command.load()
        except Exception as error:  # a package's module may fail in any way
            remedy = (
                "install what it needs, or install Cairn again"
                if cmd_name in self._own
                else "correct the package that provides it, or uninstall it"
            )
            raise CairnError(
                f"{self._kind} {command.name} ({command.target}) cannot be loaded: {error!r}; "
                f"{remedy}"
            ) from error

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Return the commands and options that complete a word, without importing a command."""
        self._only_names = True
        try:
            return super().shell_complete(ctx, incomplete)
        finally:
            self._only_names = False

    def invoke(self, ctx: Any) -> Any:
        """Invoke a command; the error about a missing argument lists what could be given."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            # Of the library's public names, only this base class of the error is in all versions.
            if type(error).__name__ == "MissingParameter" and not error.message:
                error.message = _choices(error)
            raise

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with their summaries, by section."""
        commands = list(self._all())
        width = max((len(command.name) for command in commands), default=0)
        for section in dict.fromkeys(command.section for command in commands):
            rows = [
                (command.name.ljust(width), self._summary(ctx, command))
                for command in commands
                if command.section == section
            ]
            with formatter.section(section):
                formatter.write_dl(rows)

    def _summary(self, ctx: Any, command: LazyCommand) -> str:
        if command.summary is not None:
            return command.summary
        try:
            return _first_paragraph(self.get_command(ctx, command.name))
        except CairnError as error:
            return f"broken: {error.__cause__!r}"

    def _all(self) -> Iterator[LazyCommand]:
        yield from self._own.values()
        installed = self._installed()
        yield from (installed[name] for name in sorted(installed) if name not in self._own)

    def _installed(self) -> dict[str, LazyCommand]:
        """Return the commands of installed packages; this reads the metadata of every package.

        Beside commands of our own, the help lists them by their packages, which it does not import.
        """
        from importlib.metadata import entry_points  # takes 40 ms: not for commands of our own

        return {
            point.name: LazyCommand(
                point.name,
                point.value,
                _package_summary(point) if self._own else None,
                _OF_OTHER_PACKAGES if self._own else "Commands",
                self._negative_numbers,
            )
            for point in entry_points(group=self._entry_points)
        }


def _first_paragraph(command: Any) -> str:
    return " ".join((command.help or "").partition("\n\n")[0].split())


def _package_summary(point: Any) -> str:
    if point.dist is None:
        return ""
    summary = point.dist.metadata.get("Summary", "")
    package = f"{point.dist.name} {point.dist.version}"
    return f"{package}: {summary}" if summary else package


def _choices(error: Any) -> str:
    """Return what could be given for a missing argument, by what completes it in a shell."""
    if error.param is None or error.ctx is None:
        return ""
    known = [item.value for item in error.param.shell_complete(error.ctx, "")]
    more = [f"and {len(known) - _MAX_CHOICES} more"] if len(known) > _MAX_CHOICES else []
    return f"There are: {', '.join([*known[:_MAX_CHOICES], *more])}" if known else ""


def _no_options() -> None:
    """Take no options of its own."""


PROBES_GROUP = "cairn.probes"
"""Entry points of this group add kinds of devices: each a function as typer takes it."""

EMULATORS_GROUP = "cairn.emulators"
"""Entry points of this group add emulators: each a function as typer takes it."""

driver = typer.Typer(help="Try a device without a deployment.", no_args_is_help=True)
_probe = typer.Typer(
    cls=lazy_group(entry_points=PROBES_GROUP, kind="probe"),
    help="Identify a device, and print what it measures.",
    no_args_is_help=True,
)
emulate = typer.Typer(
    cls=lazy_group(entry_points=EMULATORS_GROUP, kind="emulator"),
    help="Emulate a device on a serial port in software, or on a TCP port, with faults on request.",
    no_args_is_help=True,
)
_probe.callback()(_no_options)
driver.callback()(_no_options)
emulate.callback()(_no_options)
driver.add_typer(_probe, name="probe")
