"""Steady speed of a model with its 95 % band."""

from typing import TYPE_CHECKING, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import ndtri

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.logs.record import DISPLACEMENT
from hitchid.model.bands import Band
from hitchid.model.channel import Channel
from hitchid.model.estimates import Characteristics, Estimates
from hitchid.model.inputs import Load, Numbers, load_row
from hitchid.structures import PhysicalModel, speeds_at

if TYPE_CHECKING:
    from hitchid.model.hitch import Hitch


# Channel, displacement and load that a steady speed or a linear model is for.


def linear_channel(model: "Hitch", direction: str | None, *, instead: str) -> Channel:
    """Return the channel of a direction; None stands for the only one of a model with one channel.

    Raises:
        InputError: the model has no such channel, or its structure is not linear; then use `instead`.
    """
    if direction is None and len(model.channels) == 1:
        (channel,) = model.channels.values()
    else:
        channel = model.channels[checks.one_of(direction, model.channels, "direction")]
    structure = channel.benchmark.structure
    if structure.linear is None:
        raise InputError(
            f"direction: the {channel.direction} channel has the nonlinear structure '{structure.name}'; "
            f"expected a linear one; use {instead}"
        )
    return channel


def load_of_channel(channel: Channel, load: Load | None) -> Float[np.ndarray, "*m c"]:
    """Return a load in the order of the channel's covariates; see `load_row`."""
    return load_row(load, [channel], f"{channel.direction} channel")


def centre(channel: Channel) -> float:
    """Return the middle of the displacement in the tests; zero without nonlinearities."""
    nonlinearity = channel.benchmark.nonlinearity
    return 0.0 if nonlinearity is None else float(nonlinearity.scales.centre)


NORMAL_QUANTILE = float(ndtri(0.975))  # of a 95 % interval
STROKE, BY_LOAD = ("position_slope", "position_curve"), "gain_by_"  # parameters of the gain g(x), of K(c)
INSTEAD = "`simulate` with a constant command"


@short_repr
class SteadySpeed(NamedTuple):
    """Steady speed at constant command.

    Attributes:
        speed: positive where the displacement grows, in `unit`.
        band: 95 % interval of the speed, infinite where the tests do not determine it; None in a model
            without uncertainty.
        unit: unit of both.
    """

    speed: np.ndarray
    band: Band | None
    unit: str


@double_precision
def speed_with_band(
    model: "Hitch",
    command: Numbers,
    direction: str | None = None,
    *,
    displacement: Numbers | None = None,
    load: Load | None = None,
) -> SteadySpeed:
    """Return the steady speed at constant command; see `Hitch.speed`."""
    channel = linear_channel(model, direction, instead=INSTEAD)
    at_load = load_of_channel(channel, load)
    arrays = (
        checks.numbers(command, "command"),
        checks.numbers(centre(channel) if displacement is None else displacement, "displacement"),
        at_load[..., 0],
    )
    try:
        commands, positions, _ = np.broadcast_arrays(*arrays)
    except ValueError as error:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise InputError(
            f"command, displacement and load: expected shapes that broadcast, got {shapes}"
        ) from error
    loads = np.broadcast_to(at_load, (*commands.shape, at_load.shape[-1])).reshape(commands.size, -1)
    points = _Points(commands.ravel(), positions.ravel(), loads)
    speeds = _speeds(channel, points)
    uncertainty = model.uncertainty.get(channel.direction)
    band = None
    if uncertainty is not None and uncertainty.characteristics is not None:
        ends = _ends(channel, points, uncertainty.characteristics, uncertainty.benchmark)
        lower, upper = np.sort(_signed(channel, np.sign(points.command) * ends), axis=0)
        band = Band(lower.reshape(commands.shape), upper.reshape(commands.shape))
    signed = _signed(channel, speeds).reshape(commands.shape)
    return SteadySpeed(signed, band, f"{model.units[DISPLACEMENT]}/s")


class _Points(NamedTuple):
    """Operating points: commands and displacements, shape [Q], and covariates, shape [Q, C]."""

    command: Float[np.ndarray, " q"]
    displacement: Float[np.ndarray, " q"]
    load: Float[np.ndarray, "q c"]


def _signed(channel: Channel, speeds: Float[np.ndarray, "*q"]) -> Float[np.ndarray, "*q"]:
    """Return speeds of travel as those of the displacement, without negative zeros."""
    return channel.sign * speeds + 0.0


def _speeds(channel: Channel, points: _Points) -> Float[np.ndarray, " q"]:
    """Return speeds in the direction of travel, shape [Q]."""
    command, displacement, load = map(jnp.asarray, points)
    return np.asarray(speeds_at(channel.benchmark, command, displacement, load, channel.dead_zone))


def _ends(
    channel: Channel, points: _Points, characteristics: Characteristics, estimates: Estimates
) -> Float[np.ndarray, "2 q"]:
    """Return the smallest and largest size of the speed, shape [2, Q].

    At the points of the speed map they are the ends of its intervals. Between its levels and loads the half
    width as a share of the speed is interpolated, beyond them it is held. Below the lowest level the half
    width falls to zero at the lower end of the interval of the opening, or of the dead zone. Away from mid
    stroke, and from the loads of the map, the error of the gain along the stroke is added in quadrature.
    """
    size = np.abs(points.command)
    levels, loads, shares = _map_shares(characteristics)
    held_loads, held_load = _held_loads(channel, points, characteristics, loads)
    extra = _gain_error(channel, points, held_loads, estimates)
    begin = (characteristics.opening or characteristics.dead_zone).interval[0] or 0.0
    fade = np.clip((size - begin) / max(levels[0] - begin, np.finfo(float).tiny), 0.0, 1.0)
    # Below the lowest level the width is a share of the speed there: of one near zero it would be none.
    speeds, reference = (
        np.abs(_speeds(channel, points._replace(command=command)))
        for command in (size, np.maximum(size, levels[0]))
    )
    lower, upper = (
        _half_width(fade, reference, np.hypot(_interpolated(size, held_load, levels, loads, side), extra))
        for side in shares
    )
    return np.stack([np.maximum(speeds - lower, 0.0), speeds + upper])


def _held_loads(
    channel: Channel, points: _Points, characteristics: Characteristics, loads: Float[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, "q c"], Float[np.ndarray, " q"]]:
    """Return the loads of the speed map next to the points, and those of its own covariate.

    The map is for the means of the other covariates.
    """
    held = np.tile(np.asarray(channel.benchmark.mean_load), (points.command.size, 1))
    if characteristics.load is None:
        return held, np.zeros(points.command.size)
    column = channel.benchmark.covariates.index(characteristics.load)
    held[:, column] = np.clip(points.load[:, column], loads[0], loads[-1])
    return held, held[:, column]


def _half_width(
    fade: Float[np.ndarray, " q"], reference: Float[np.ndarray, " q"], share: Float[np.ndarray, " q"]
) -> Float[np.ndarray, " q"]:
    """Return fade × reference × share; infinite for an infinite share, unless it has faded to zero."""
    # The inner choice keeps infinity times a fade of zero, which is no number, out of the product.
    is_finite = np.isfinite(share)
    width = np.where(is_finite, fade * reference * np.where(is_finite, share, 0.0), np.inf)
    return np.where(fade > 0, width, 0.0)


def _map_shares(
    characteristics: Characteristics,
) -> tuple[Float[np.ndarray, " l"], Float[np.ndarray, " k"], Float[np.ndarray, "2 l k"]]:
    """Return levels, loads, and the distances of the interval's ends as shares of the speed."""
    points = characteristics.speed_map
    levels = np.unique([point.command for point in points])
    loads = np.unique([point.load or 0.0 for point in points])
    by_place = sorted(points, key=lambda point: (point.command, point.load or 0.0))
    shares = [
        [_share(point.speed, point.interval[0] or 0.0), _share(point.speed, point.interval[1])]
        for point in by_place
    ]
    return levels, loads, np.array(shares).T.reshape(2, levels.size, loads.size)


def _share(speed: float, end: float | None) -> float:
    return np.inf if end is None or not speed > 0 else abs(end - speed) / speed


def _interpolated(
    command: Float[np.ndarray, " q"],
    load: Float[np.ndarray, " q"],
    levels: Float[np.ndarray, " l"],
    loads: Float[np.ndarray, " k"],
    shares: Float[np.ndarray, "l k"],
) -> Float[np.ndarray, " q"]:
    """Return shares interpolated in load, then in command, and held beyond; infinite next to an open end."""

    def weights(values: np.ndarray, knots: np.ndarray) -> Float[np.ndarray, "q m"]:
        """Return the weight of each knot in the linear interpolation at each value."""
        return np.stack([np.interp(values, knots, row) for row in np.eye(knots.size)], axis=1)

    by_knot = weights(command, levels)[:, :, None] * weights(load, loads)[:, None, :]
    products = np.multiply(by_knot, shares, where=by_knot > 0, out=np.zeros_like(by_knot))
    return products.sum(axis=(1, 2))


def _gain_error(
    channel: Channel, points: _Points, held_loads: Float[np.ndarray, "q c"], estimates: Estimates
) -> Float[np.ndarray, " q"]:
    """Return half the 95 % interval of log K g(x) less that at mid stroke and the map's load, shape [Q].

    Infinite where it depends on a parameter without a standard error.
    """
    benchmark = channel.benchmark
    slots = [parameter.name for parameter in benchmark.parameters]
    names = [estimate.name for estimate in estimates.parameters]
    numbers = [n for n, name in enumerate(names) if name in STROKE or name.startswith(BY_LOAD)]
    if benchmark.nonlinearity is None or not numbers:
        return np.zeros(points.command.size)
    columns = [slots.index(names[number]) for number in numbers]
    middle = np.full(points.command.size, centre(channel))
    here, there = (
        np.asarray(_log_gain_gradient(benchmark, jnp.asarray(position), jnp.asarray(load)))
        for position, load in ((points.displacement, points.load), (middle, held_loads))
    )
    change = (here - there)[:, columns]
    errors = [estimates.parameters[number].error for number in numbers]
    unknown = np.any((change != 0) & np.array([error is None for error in errors]), axis=1)
    scaled = change * np.array([error or 0.0 for error in errors])
    correlation = np.array(estimates.correlation)[np.ix_(numbers, numbers)]
    np.fill_diagonal(correlation, 1.0)
    variance = np.maximum(np.einsum("qi,ij,qj->q", scaled, correlation, scaled), 0.0)
    return np.where(unknown, np.inf, NORMAL_QUANTILE * np.sqrt(variance))


@eqx.filter_jit
def _log_gain_gradient(
    benchmark: PhysicalModel, displacement: Float[Array, " q"], load: Float[Array, "q c"]
) -> Float[Array, "q r"]:
    def log_gain(vector: Array, position: Array, load: Array) -> Array:
        at_load = benchmark.with_parameter_vector(vector).at_load(load)
        stroke = 1.0 if at_load.nonlinearity is None else at_load.nonlinearity.gain(position)
        return jnp.log(at_load.gain * stroke)

    return jax.vmap(jax.grad(log_gain), (None, 0, 0))(benchmark.parameter_vector, displacement, load)
