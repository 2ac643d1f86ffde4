"""Parameters that machines of a fleet are compared in, and their estimates from a row."""

import csv
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from math import isfinite
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.special import digamma, polygamma

from hitchid.errors import InputError
from hitchid.fleet.row import DirectionRow, Row
from hitchid.fleet.store import Store
from hitchid.logs import COMMAND, DISPLACEMENT

# Metadata of the machines of a fleet: a CSV file with a line for each machine.

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
        chosen = [lines.get(machine) for machine in machines]
        return {
            name: tuple(None if line is None else cells[line] for line in chosen)
            for name, cells in self.columns.items()
        }

    def notices(self, machines: Iterable[str], compared: Iterable[str]) -> tuple[str, ...]:
        """Return which of the compared machines have no line, and which lines are of no machine."""
        notices = []
        if absent := sorted(set(compared) - set(self.machines)):
            notices.append(f"{self.source}: no line for {listed(absent)}; not in the cohorts")
        if unknown := sorted(set(self.machines) - set(machines)):
            notices.append(f"{self.source}: there is no result for {listed(unknown)}; left out")
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
    # Through a store, so that the table may lie beside the logs in a bucket.
    folder, _, name = (
        source.rpartition("/") if "://" in source else (str(Path(source).parent), "", Path(source).name)
    )
    store = Store(folder)
    if not store.has(name):
        raise InputError(f"{source}: does not exist; expected a CSV file with a column '{MACHINE}'")
    try:
        # A spreadsheet writes a byte order mark, and empty lines at the end.
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
        raise InputError(f"{source}: got {listed(repeated)} twice, expected one line for each machine")
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


def listed(names: Sequence[str], most: int = 5) -> str:
    """Return the first names, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


GAIN, DEAD_ZONE, DELAY, LOAD_SCATTER = "gain", "dead zone", "delay", "load scatter"
NAMES = (GAIN, DEAD_ZONE, DELAY, LOAD_SCATTER)
LOGARITHMIC = frozenset({GAIN, LOAD_SCATTER})  # compared as logarithms: their errors are relative
FEWEST_TESTS = 6  # from which the logarithm of a scatter is close to normally distributed; chosen
PERCENT = 100.0
MAX_CORRELATION = 0.99  # of ln gain and dead zone; chosen: the covariance has to be positive definite


@dataclass(frozen=True)
class FleetParameter:
    """One parameter of one direction.

    Attributes:
        direction: lifting or lowering.
        name: gain, dead zone, delay or load scatter.
        unit: of its value; a load scatter is in percent of the speed.
    """

    direction: str
    name: str
    unit: str

    @property
    def logarithmic(self) -> bool:
        """Whether the estimate is the natural logarithm of the value."""
        return self.name in LOGARITHMIC

    def value(self, estimate: np.ndarray | float) -> np.ndarray:
        """Return values in the parameter's unit from estimates."""
        return np.asarray(np.exp(estimate) if self.logarithmic else estimate, float)

    def difference(self, deviation: np.ndarray | float) -> np.ndarray:
        """Return a difference of estimates: in the unit, or relative where they are logarithms."""
        return np.asarray(np.expm1(deviation) if self.logarithmic else deviation, float)


@dataclass(frozen=True, order=True)
class Kind:
    """What gains must have in common to be comparable: structure and units."""

    structure: str
    displacement_unit: str
    command_unit: str

    @property
    def speed_unit(self) -> str:
        """Unit of the speed."""
        return f"{self.displacement_unit}/s"

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        gain = f"{self.speed_unit}/{self.command_unit}"
        return {GAIN: gain, DEAD_ZONE: self.command_unit, DELAY: "s", LOAD_SCATTER: "%"}[name]


def kind_of(row: Row, direction: str) -> Kind:
    """Return structure and units of one direction of a machine."""
    return Kind(
        row.directions[direction].structure,
        row.units.get(DISPLACEMENT, ""),
        row.units.get(COMMAND.get(direction, ""), ""),
    )


def estimates_of_row(figures: DirectionRow) -> tuple[Float[np.ndarray, " 4"], Float[np.ndarray, "4 4"]]:
    """Return ln gain, dead zone, delay and ln load scatter with their covariance, NaN where missing.

    For the scatter s of n tests, ν s²/σ² is χ² with ν = n − 1: ln s has the mean ln σ + (ψ(ν/2) − ln(ν/2))/2
    and the variance ψ′(ν/2)/4.
    """
    scatter, half_freedom = figures.load_scatter, (figures.tests - 1) / 2
    log_scatter, scatter_error = np.nan, None
    # Of few tests the logarithm is skewed: a tail of small scatters would be machines that stand out.
    if scatter is not None and scatter > 0 and figures.tests >= FEWEST_TESTS:
        log_scatter = np.log(PERCENT * scatter) - (digamma(half_freedom) - np.log(half_freedom)) / 2
        scatter_error = float(np.sqrt(polygamma(1, half_freedom))) / 2
    values = np.array(
        [
            np.log(figures.gain) if figures.gain > 0 else np.nan,
            figures.dead_zone,
            np.nan if figures.delay_s is None else figures.delay_s,
            log_scatter,
        ]
    )
    errors = figures.gain_error, figures.dead_zone_error, figures.delay_error_s, scatter_error
    deviations = np.array([error if error else np.nan for error in errors], float)
    correlation = np.eye(len(NAMES))
    correlation[0, 1] = correlation[1, 0] = np.clip(figures.correlation, -MAX_CORRELATION, MAX_CORRELATION)
    return np.where(np.isnan(deviations), np.nan, values), correlation * np.outer(deviations, deviations)
