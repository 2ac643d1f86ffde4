"""What a simulation takes: a record, or what is one, or commands without a measurement."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from hitchid._support import checks
from hitchid._support.records import Value
from hitchid.errors import InputError
from hitchid.logs.record import COMMAND, DIRECTIONS, DISPLACEMENT, LIFTING, LOWERING, Record

if TYPE_CHECKING:
    from hitchid.model.channel import Channel


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
    """Return the record of a log's path, or of a table that has its own clock; anything else as it is."""
    if isinstance(value, str | Path):
        return required_record(value)
    if isinstance(value, Frame):
        # Columns named as commands, or a sampling time beside the table: then it has no clock of its own.
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
        from hitchid.logs import read  # not for a model that is loaded and stepped

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
    """Return commands, see `Hitch.simulate`, as a record, whose displacement is zero and says nothing.

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
    # `asarray` would drop the mask, and take what it hides for commands.
    if np.ma.is_masked(values):
        raise InputError("commands: expected numbers without a mask, got a masked array")
    array = checks.array(values, "commands", COMMANDS, "numbers")
    if array.ndim not in dimensions:
        raise checks.input_error("commands", COMMANDS, values)
    return array.astype(np.float64)


# Covariates of a model: what a user gives as its load, and the row of numbers that the model takes.

Load = Numbers | Mapping[str, Numbers]  # of a model with one covariate, or by the names of several


def covariates_of(channels: Iterable["Channel"]) -> tuple[str, ...]:
    """Return the names of the covariates that channels require, in their order."""
    return tuple(dict.fromkeys(name for channel in channels for name in channel.benchmark.covariates))


def mean_load(channels: Iterable["Channel"]) -> Float[np.ndarray, " l"]:
    """Return the mean of each covariate in the identification tests; one zero where there is none."""
    means: dict[str, float] = {}
    for benchmark in (channel.benchmark for channel in channels if channel.benchmark.covariates):
        values = np.asarray(benchmark.mean_load).tolist()
        for name, value in zip(benchmark.covariates, values, strict=True):
            means.setdefault(name, value)
    return np.array([*means.values()] or [0.0])


def loads_by_name(load: Load | None, names: Sequence[str], owner: str) -> dict[str, Float[np.ndarray, "*m"]]:
    """Return the covariates that are given as a load, by name; `owner` is what has them, for the message.

    Raises:
        InputError: there is no such covariate, or a value is not a number.
    """
    if load is None:
        return {}
    listed = " and ".join(names)
    if not names:
        raise InputError(f"load: the {owner} has no covariate; expected None, got {load}")
    if not isinstance(load, Mapping):
        if len(names) > 1:
            raise InputError(
                f"load: the {owner} has the covariates {listed}; expected their values by name, got {load}"
            )
        return {names[0]: checks.numbers(load, "load")}
    for name in load:
        if name not in names:
            raise InputError(f"load: the {owner} has no covariate '{name}'; expected {listed}")
    return {name: checks.numbers(values, f"load, {name}") for name, values in load.items()}


def load_row(load: Load | None, channels: Sequence["Channel"], owner: str) -> Float[np.ndarray, "*m l"]:
    """Return a load in the order of `covariates_of`; what is not given is the mean of the tests.

    Raises:
        InputError: as `loads_by_name`, or given values differ in number.
    """
    names, means = covariates_of(channels), mean_load(channels)
    given: dict[str, ArrayLike] = dict(zip(names, means.tolist(), strict=False))
    given |= loads_by_name(load, names, owner)
    return stacked([given[name] for name in names])


def load_to_estimate(
    load: "Load | Mapping[str, Numbers | None] | None", channels: Sequence["Channel"], owner: str
) -> Float[np.ndarray, "*m l"]:
    """Return `load_row`, with NaN for each covariate that is given as None: it is not measured.

    Raises:
        InputError: as `load_row`.
    """
    if not isinstance(load, Mapping):
        return load_row(load, channels, owner)
    # Any number in place of None: the others are checked with it, and NaN replaces it.
    row = load_row({name: 0.0 if value is None else value for name, value in load.items()}, channels, owner)
    names = covariates_of(channels)
    not_measured = np.array([name in load and load[name] is None for name in names])
    return np.where(not_measured, np.nan, row) if names else row


def stacked(columns: Sequence[ArrayLike]) -> Float[np.ndarray, "*m l"]:
    """Return the values of covariates as rows; one zero for none.

    Raises:
        InputError: they differ in number.
    """
    try:
        return np.stack(np.broadcast_arrays(*(columns or (0.0,))), axis=-1)
    except ValueError as error:
        sizes = " and ".join(str(np.size(column)) for column in columns)
        raise InputError(f"load: expected equal numbers of values, got {sizes}") from error


def channel_load(
    channels: Sequence["Channel"], number: int, load: Float[Array, "*m l"]
) -> Float[Array, "*m c"]:
    """Return the covariates of one channel from those of the hitch; one zero where it has none."""
    names, all_names = channels[number].benchmark.covariates, covariates_of(channels)
    if not names:
        return jnp.zeros((*load.shape[:-1], 1))
    return load[..., np.array([all_names.index(name) for name in names])]
