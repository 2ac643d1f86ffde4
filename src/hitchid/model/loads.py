"""Covariates of a model: what a user gives as its load, and the row of numbers that the model takes."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from hitchid._support import checks
from hitchid.errors import InputError
from hitchid.model.commands import Numbers

if TYPE_CHECKING:
    from hitchid.model.channel import Channel

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
    """Return the covariates that are given as a load, by name.

    Args:
        load: with one covariate a number or several, else covariate to number or numbers.
        names: of the covariates.
        owner: what has the covariates, for the message: `model` or `lifting channel`.

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

    Args:
        load, owner: as for `loads_by_name`.
        channels: of the model.

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
    names, known = channels[number].benchmark.covariates, covariates_of(channels)
    if not names:
        return jnp.zeros((*load.shape[:-1], 1))
    return load[..., np.array([known.index(name) for name in names])]
