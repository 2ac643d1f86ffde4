"""What a simulation takes: a record, or what is one, or commands without a measurement."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jax.typing import ArrayLike

from hitchid._support import checks
from hitchid._support.values import Value
from hitchid.data.record import COMMAND, DIRECTIONS, DISPLACEMENT, LIFTING, LOWERING, Record
from hitchid.errors import InputError


@runtime_checkable
class SupportsArray(Protocol):
    """What NumPy can take as an array, such as a pandas Series."""

    def __array__(self) -> np.ndarray:
        """Return the array."""
        ...


@runtime_checkable
class Frame(Protocol):
    """A table with named columns, such as a pandas or polars DataFrame."""

    columns: Iterable[str]

    def __getitem__(self, name: str) -> SupportsArray:
        """Return a column."""
        ...


COMMANDS = "a record, a DataFrame, the path of a log, columns, or an array of shape [N, 2] or [N]"
Numbers = ArrayLike | SupportsArray | Sequence[Any]
Commands = Mapping[str, Numbers] | Frame | Numbers


def record_or_commands(
    value: Record | Commands | str | Path, directions: Sequence[str], step_s: float | None
) -> Record | Commands:
    """Return the record of a log's path, or of a table that has its own clock; anything else as it is.

    Args:
        value: see `Hitch.simulate`.
        directions: directions of the model's channels.
        step_s: sampling time of commands; None for a record.
    """
    if isinstance(value, str | Path):
        return required_record(value)
    if isinstance(value, Frame):
        has_commands = {COMMAND[direction] for direction in directions} <= set(value.columns)
        return value if has_commands or step_s is not None else required_record(value)
    if isinstance(value, Value) and not isinstance(value, Record):
        raise checks.input_error("commands", COMMANDS, value)
    if not isinstance(value, Record | Mapping):
        _numbers(value, 1, 2)  # what is no command at all is refused before a missing initial displacement
    return value


def required_record(value: object) -> Record:
    """Return a record, or the one of a table or of a log's path.

    Raises:
        InputError: it is none of them, the log or table cannot be used, or gaps divide it.
    """
    if isinstance(value, str | Path):
        from hitchid.readers import read  # not for a model that is loaded and stepped

        campaign = read(value)
        if len(campaign) > 1:
            raise InputError(
                f"{value}: expected one record, got {len(campaign)}: "
                f"{', '.join(record.name for record in campaign)}; hitchid.read gives each of them"
            )
        return campaign.records[0]
    if isinstance(value, Frame):
        return Record.from_dataframe(value)
    return checks.instance(value, Record, "record", "a record, a DataFrame, or the path of a log")


def record_of_commands(
    commands: Commands, directions: Sequence[str], units: Mapping[str, str], step_s: float | None
) -> Record:
    """Return commands as a record, whose displacement is zero and says nothing.

    Args:
        commands: see `Hitch.simulate`.
        directions: directions of the model's channels.
        units: role to unit of the model.
        step_s: sampling time of the commands, s.

    Raises:
        InputError: the sampling time is missing, or the commands are no numbers, or of another shape.
    """
    if step_s is None:
        raise InputError("step_s: expected the sampling time of the commands, s; got None")
    signals = _by_role(commands, directions)
    (count, *_) = {samples.size for samples in signals.values()}
    if not count:
        raise InputError("commands: expected at least one sample, got none")
    signals[DISPLACEMENT] = np.zeros(count)
    return Record("commands", step_s, signals, {role: units.get(role, "1") for role in signals})


def _by_role(commands: Commands, directions: Sequence[str]) -> dict[str, np.ndarray]:
    if isinstance(commands, Mapping | Frame):
        names = list(commands.columns if isinstance(commands, Frame) else commands)
        required = [COMMAND[direction] for direction in directions]
        if missing := [role for role in required if role not in names]:
            raise InputError(
                f"commands: expected columns {' and '.join(required)}; {missing[0]} is missing, "
                f"found {', '.join(map(str, names)) or 'none'}"
            )
        return {role: _numbers(commands[role], 1) for role in COMMAND.values() if role in names}
    samples = _numbers(commands, 1, 2)
    if samples.ndim == 2 and samples.shape[1] == len(DIRECTIONS):
        return {COMMAND[direction]: samples[:, column] for column, direction in enumerate(DIRECTIONS)}
    if samples.ndim == 2:
        raise InputError(f"commands: expected shape [N, 2], lifting and lowering; got {samples.shape}")
    if len(directions) == 1:
        return {COMMAND[directions[0]]: samples}
    return {COMMAND[LIFTING]: np.maximum(samples, 0.0), COMMAND[LOWERING]: np.maximum(-samples, 0.0)}


def _numbers(values: Numbers, *dimensions: int) -> np.ndarray:
    """Return an array of real numbers of one of the given numbers of dimensions."""
    if np.ma.is_masked(values):
        raise InputError("commands: expected numbers without a mask, got a masked array")
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:
        raise checks.input_error("commands", "numbers", values) from error
    if array.dtype.kind not in "iuf" or array.ndim not in dimensions:
        raise checks.input_error("commands", COMMANDS, values)
    return array.astype(np.float64)
