"""Metadata of the machines of a fleet: a CSV file with a line for each machine."""

import csv
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from math import isfinite
from pathlib import Path

from hitchid.errors import InputError
from hitchid.fleet.store import Store

MACHINE = "machine"  # the column with the name of the machine's folder

Cells = tuple[str | float | None, ...]  # of one column: texts or numbers


@dataclass(frozen=True)
class Metadata:
    """Properties of machines.

    Attributes:
        source: file that it was read from, for messages.
        machines: names, shape [M].
        columns: name to a text or a number for each machine; None where unknown.
    """

    source: str
    machines: tuple[str, ...]
    columns: Mapping[str, Cells]

    def of(self, machines: Sequence[str]) -> dict[str, Cells]:
        """Return the columns in the order of some machines; None for a machine that is not in the table."""
        lines = {machine: number for number, machine in enumerate(self.machines)}
        found = [lines.get(machine) for machine in machines]
        return {
            name: tuple(None if line is None else cells[line] for line in found)
            for name, cells in self.columns.items()
        }

    def notices(self, machines: Iterable[str], compared: Iterable[str]) -> tuple[str, ...]:
        """Return which of the compared machines have no line, and which lines are of no machine."""
        known = set(machines)
        notices = []
        if absent := sorted(set(compared) - set(self.machines)):
            notices.append(f"{self.source}: no line for {_listed(absent)}; not in the cohorts")
        if unknown := sorted(set(self.machines) - known):
            notices.append(f"{self.source}: there is no result for {_listed(unknown)}; left out")
        return tuple(notices)


def read_metadata(path: str | Path) -> Metadata:
    """Return the properties of machines from a CSV file.

    A column in which every known cell is a finite number is one of numbers, every other one of texts.

    Args:
        path: of the file, or its URL as for a store.

    Raises:
        InputError: it cannot be read, or has no column `machine` or nothing beside it, lines of another
            length, or a machine twice.
    """
    source = str(path)
    folder, _, name = (
        source.rpartition("/") if "://" in source else (str(Path(source).parent), "", Path(source).name)
    )
    store = Store(folder)
    if not store.has(name):
        raise InputError(f"{source}: does not exist; expected a CSV file with a column '{MACHINE}'")
    try:
        text = store.read(name).decode("utf-8-sig")
        header, *lines = [line for line in csv.reader(StringIO(text), strict=True) if any(line)] or [[]]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{source}: is not a CSV file in UTF-8: {error}") from error
    columns = _columns(source, [cell.strip() for cell in header], lines)
    machines = columns.pop(MACHINE)
    if not columns:
        raise InputError(f"{source}: got the column '{MACHINE}' alone, expected further columns")
    repeated = [machine for machine, count in Counter(machines).items() if count > 1]
    if repeated:
        raise InputError(f"{source}: got {_listed(repeated)} twice, expected one line for each machine")
    return Metadata(source, tuple(machines), {name: _cells(column) for name, column in columns.items()})


def _columns(source: str, header: Sequence[str], lines: Sequence[Sequence[str]]) -> dict[str, list[str]]:
    if MACHINE not in header or len(set(header)) < len(header):
        got = ", ".join(header) or "nothing"
        raise InputError(f"{source}: columns: got {got}, expected '{MACHINE}' and others, each once")
    for number, line in enumerate(lines, start=1):
        if len(line) != len(header):
            raise InputError(
                f"{source}: line {number} below the header: got {len(line)} cells, expected {len(header)}"
            )
    return {name: [line[column].strip() for line in lines] for column, name in enumerate(header)}


def _cells(texts: Sequence[str]) -> Cells:
    numbers = [_number(text) for text in texts if text]
    if numbers and all(number is not None for number in numbers):
        return tuple(_number(text) for text in texts)
    return tuple(text or None for text in texts)


def _number(text: str) -> float | None:
    try:
        number = float(text)
    except ValueError:
        return None
    return number if isfinite(number) else None


def _listed(names: Sequence[str], most: int = 5) -> str:
    """Return some names, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")
