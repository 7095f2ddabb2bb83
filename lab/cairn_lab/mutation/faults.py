"""Read, check and write the list of deliberate faults."""

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

ROOT = Path(__file__).parents[3]
FILE = Path(__file__).with_name("faults.yaml")
NO_TEST = "none"

_HEADER = """\
# Deliberate faults. `python -m cairn_lab.mutation` applies each of them to a copy of the code and
# runs its tests; see cairn_lab/mutation/__main__.py. `find` occurs exactly once in `file`.
# `caught_by` is the first test that failed when the fault was last recorded, or none. With
# `--record` the runner rewrites this file; comments other than this one are lost.
"""


class Fault(BaseModel):
    """A small change of the code that could be made by mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    id: str = Field(pattern=r"^[a-z0-9-]+$")
    area: str
    file: str
    find: str
    replace: str
    fault: str
    tests: tuple[str, ...] = Field(min_length=1)
    caught_by: str = NO_TEST


def read_faults(file: Path = FILE) -> list[Fault]:
    """Read the list of faults; raise `ValueError` if an entry is invalid."""
    return [Fault.model_validate(entry) for entry in yaml.safe_load(file.read_text("utf-8"))]


def write_faults(faults: Sequence[Fault], file: Path = FILE) -> None:
    """Write the list of faults, in place of the old one."""
    entries = [{**fault.model_dump(), "tests": list(fault.tests)} for fault in faults]
    text = yaml.dump(entries, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=98)
    file.write_text(_HEADER + text.replace("\n- id:", "\n\n- id:"), "utf-8")


def mutated(fault: Fault, source: str) -> str:
    """Return the source of the file with the fault applied."""
    return source.replace(fault.find, fault.replace)


def problems(faults: Sequence[Fault], root: Path = ROOT) -> Iterator[str]:
    """Yield a message for each fault that cannot be applied to the code under `root`."""
    for name, count in Counter(fault.id for fault in faults).items():
        if count > 1:
            yield f"{name}: {count} faults have this id; give each its own"
    for fault in faults:
        for test in fault.tests:
            if not (root / test.partition("::")[0]).exists():
                yield f"{fault.id}: test {test} does not exist; correct `tests`"
        path = root / fault.file
        if not path.is_file():
            yield f"{fault.id}: file {fault.file} does not exist; correct `file`"
            continue
        source = path.read_text("utf-8")
        count = source.count(fault.find)
        if count != 1:
            yield f"{fault.id}: `find` occurs {count} times in {fault.file}; it must occur once"
            continue
        if fault.find == fault.replace:
            yield f"{fault.id}: `replace` is the same as `find`"
        try:
            compile(mutated(fault, source), fault.file, "exec")
        except SyntaxError as error:
            yield f"{fault.id}: {fault.file} is not valid Python with the fault: {error}"


class _Dumper(yaml.SafeDumper):
    """Dumper that writes code as literal blocks."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        """Indent lists within an entry."""
        del indentless  # PyYAML sets it for lists, which then stand as far left as their key
        return super().increase_indent(flow, False)


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    style = "|" if "\n" in text else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _text)
