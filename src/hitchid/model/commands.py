"""Commands without a measurement, from an array or a table."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jax.typing import ArrayLike

from hitchid._support import checks
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


Numbers = ArrayLike | SupportsArray | Sequence[Any]
Commands = Mapping[str, Numbers] | Frame | Numbers


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
        raise checks.input_error("commands", "a record, columns, or an array of shape [N, 2] or [N]", values)
    return array.astype(np.float64)
