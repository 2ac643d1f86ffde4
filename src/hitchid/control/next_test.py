"""Optimal experiment design: the next test within limits that reduces a parameter's standard error most."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import floor
from pathlib import Path
from types import MappingProxyType

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import qmc

from hitchid._support import checks
from hitchid._support.files import write_file
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.bench.excitation import prbs, precompensated
from hitchid.errors import InputError
from hitchid.logs import COMMAND, command_columns, effective_command, write_table
from hitchid.model import Channel, Hitch, Information
from hitchid.structures import Batch, PhysicalModel, padded_length
from hitchid.uncertainty import (
    profile_out_gain,
    standard_errors,
    standard_errors_with,
    standard_errors_with_repeat,
)

CANDIDATES = 256  # tests evaluated; chosen, a power of two as a Sobol sequence requires
MAX_LOW_RATIO = 0.8  # low level over high level, largest; nearer levels hardly excite the dynamics
MIN_HIGH_RATIO = 0.3  # high level over the largest command, smallest
CLOCK_S = (0.05, 3.0)  # shortest and longest hold of a level, s: from a valve's lag to a whole stroke
LENGTHS = (0.5, 1.0, 2.0)  # duration over that of a typical identification test
TRAVEL_MARGIN = 1.02  # travel over that of the identification tests: 2 % for the model's error
MAX_PROPOSALS = 5  # largest number returned
DEAD_ZONE_SHARE = 0.5  # of a parameter's variance, above which the dead zone dominates its error; chosen
ROUNDING = 1e-9  # in samples, so that a whole number is not rounded down
NO_COVARIATES: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class ExcitationLimits:
    """Limits of a test; None takes those of the identification tests.

    Attributes:
        highest: largest command, as logged, in its unit.
        travel: largest distance from the start, in the displacement's unit.
        longest_s: longest duration, s.
    """

    highest: float | None = None
    travel: float | None = None
    longest_s: float | None = None


DEFAULT_LIMITS = ExcitationLimits()


@short_repr
@dataclass(frozen=True)
class Proposal:
    """A proposed binary test.

    Attributes:
        low, high: levels of the command beyond the dead zone, in its unit.
        clock_s: shortest time a level is held, s.
        duration_s: length, s.
        seed: of the binary sequence.
        travel: largest distance from the start as simulated, in the displacement's unit.
        remaining_error: parameter to the ratio of its expected standard error after the test to that before.
    """

    low: float
    high: float
    clock_s: float
    duration_s: float
    seed: int
    travel: float
    remaining_error: Mapping[str, float]


@short_repr
@dataclass(frozen=True)
class Advice:
    """The best tests to run next, and the expected reduction of standard errors.

    Attributes:
        direction: lifting or lowering.
        parameter: the parameter whose error is reduced.
        proposals: the best first.
        baseline_reduction: parameter to the same ratio for one more test like the identification tests.
        ramps: whether the dead zone dominates the error, so that ramps reduce it more than any test.
    """

    direction: str
    parameter: str
    proposals: tuple[Proposal, ...]
    baseline_reduction: Mapping[str, float]
    ramps: bool

    def describe(self) -> dict[str, object]:
        """Return the content of JSON output."""
        keys = {"remaining_error": "left"}
        return {
            "mode": self.direction,
            "parameter": self.parameter,
            "proposals": [{keys.get(k, k): value for k, value in vars(p).items()} for p in self.proposals],
            "usual": self.baseline_reduction,
            "ramps": self.ramps,
        }


@double_precision
def design(
    model: Hitch,
    direction: str | None = None,
    *,
    parameter: str | None = None,
    limits: ExcitationLimits = DEFAULT_LIMITS,
    seed: int = 0,
) -> Advice:
    """Propose the next test: the binary tests within limits that reduce a parameter's standard error most.

    The expected standard errors follow from the derivatives of the physical model's free run by its
    parameters and the residuals of the identification tests (`uncertainty.information`).

    Args:
        model: an identified hitch.
        direction: lifting or lowering; by default that of the least determined parameter.
        parameter: whose error is reduced; by default the least determined one not at a bound.
        limits: largest command, travel and duration.
        seed: of the candidates and their sequences.

    Raises:
        InputError: the model has no such direction or parameter, or no test stays within the limits.
    """
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    checks.instance(limits, ExcitationLimits, "limits", "Limits")
    for name, value in vars(limits).items():
        if value is not None:
            checks.number(value, f"limits, {name}")
    checks.integer(seed, "seed")
    direction, parameter, information = _select_target(model, direction, parameter)
    channel, number = model.channels[direction], information.names.index(parameter)
    errors = standard_errors(information)

    def ratios(expected_errors: np.ndarray) -> dict[str, float]:
        return dict(zip(information.names, map(float, expected_errors / errors), strict=True))

    # Information adds up over independent tests, so that each candidate is judged beside those there were.
    proposals = [
        replace(proposal, remaining_error=ratios(standard_errors_with(information, jacobian)))
        for proposal, jacobian in _candidates(channel, information, limits, model.step_s, seed)
    ]
    if not proposals:
        raise InputError(
            f"{direction}: none of {CANDIDATES} candidate tests is within the limits; use wider limits"
        )
    proposals.sort(key=lambda proposal: proposal.remaining_error[parameter])
    return Advice(
        direction=direction,
        parameter=parameter,
        proposals=tuple(proposals[:MAX_PROPOSALS]),
        baseline_reduction=ratios(standard_errors_with_repeat(information)),
        ramps=bool(information.dead_zone_covariance[number][number] > DEAD_ZONE_SHARE * errors[number] ** 2),
    )


def command_of(model: Hitch, direction: str, proposal: Proposal) -> np.ndarray:
    """Return the command of a proposal with the dead zone added, in the model's unit, shape [N]."""
    zone = model.channels[direction].dead_zone
    return precompensated(_signal(proposal, model.step_s), zone)


def write_command(model: Hitch, advice: Advice, path: Path, *, force: bool = False) -> None:
    """Write the command of the best proposal, sample by sample, as CSV.

    Raises:
        OutputError: the file exists and `force` is not given, or it cannot be written.
    """
    command = command_of(model, advice.direction, advice.proposals[0])
    names = command_columns(model.channels, model.units)
    columns = {"time_s": model.step_s * np.arange(command.size)}
    for direction in model.channels:
        name = names[COMMAND[direction]].column
        columns[name] = command if direction == advice.direction else np.zeros_like(command)
    write_file(path, lambda temporary_path: write_table(temporary_path, columns), force=force)


def _select_target(
    model: Hitch, direction: str | None, parameter: str | None
) -> tuple[str, str, Information]:
    """Return direction and parameter of the widest relative interval among those requested."""
    interval_widths = {
        (channel_name, estimate.name): (estimate.log_interval_width, uncertainty.information)
        for channel_name, uncertainty in model.uncertainty.items()
        if uncertainty.information is not None
        for estimate in uncertainty.benchmark.parameters
        if estimate.name in uncertainty.information.names
    }
    matching = [key for key in interval_widths if direction in (None, key[0]) and parameter in (None, key[1])]
    if not matching:
        request = " ".join(name for name in (direction, parameter) if name) or "anything"
        available = ", ".join(" ".join(key) for key in interval_widths) or "nothing"
        raise InputError(f"design: expected a parameter with a standard error ({available}), got {request}")
    best = max(matching, key=lambda key: interval_widths[key][0])
    return *best, interval_widths[best][1]


def _candidates(
    channel: Channel, information: Information, limits: ExcitationLimits, step_s: float, seed: int
) -> Iterator[tuple[Proposal, np.ndarray]]:
    """Yield the candidates within the limits and the derivatives of their travel, shape [N, D]."""
    operating_range = channel.operating_range
    highest = float(operating_range.command.highest)
    if limits.highest is not None:
        # Limits are of the command as logged, candidates beyond the dead zone.
        highest = limits.highest - channel.dead_zone
    if not highest > 0:
        raise InputError(
            f"highest command: expected more than the dead zone, {channel.dead_zone:.4g}, "
            f"got {limits.highest:.4g}"
        )
    stroke_range = float(operating_range.displacement.highest - operating_range.displacement.lowest)
    max_travel = TRAVEL_MARGIN * stroke_range if limits.travel is None else limits.travel
    typical_s = information.samples * step_s
    longest_s = max(LENGTHS) * typical_s if limits.longest_s is None else limits.longest_s
    samples = sorted({floor(min(share * typical_s, longest_s) / step_s + ROUNDING) for share in LENGTHS})
    lengths = [step_s * max(sample_count, 1) for sample_count in samples]
    # Evenly spread, unlike random numbers: few candidates leave no corner of the limits empty.
    points = qmc.Sobol(3, rng=np.random.default_rng(seed)).random(CANDIDATES)
    for chunk, duration_s in zip(np.array_split(points, len(lengths)), lengths, strict=True):
        proposals = [
            Proposal(
                low=float(low * high * highest),
                high=float(high * highest),
                clock_s=float(CLOCK_S[0] * (CLOCK_S[1] / CLOCK_S[0]) ** clock),
                duration_s=duration_s,
                seed=seed,
                travel=0.0,
                remaining_error={},
            )
            for low, high, clock in chunk * [MAX_LOW_RATIO, 1 - MIN_HIGH_RATIO, 1.0]
            + [0.0, MIN_HIGH_RATIO, 0.0]
        ]
        commands = np.stack([_signal(candidate, step_s) for candidate in proposals])
        travel, jacobian = _derivatives(channel, information, _batch(channel, commands, step_s))
        for proposal, test_travel, slopes in zip(proposals, travel, jacobian, strict=True):
            # Padding, which gives all candidates one shape, is no part of the test.
            farthest = float(np.abs(test_travel[: commands.shape[1]]).max())
            if 0 < farthest <= max_travel:
                unpadded_travel = test_travel[: commands.shape[1]]
                yield (
                    replace(proposal, travel=farthest),
                    profile_out_gain(information, unpadded_travel, slopes[: unpadded_travel.size]),
                )


def _signal(proposal: Proposal, step_s: float) -> np.ndarray:
    """Return the effective command of a proposal, shape [N]."""
    return prbs(
        low=proposal.low,
        high=proposal.high,
        clock_s=proposal.clock_s,
        duration_s=proposal.duration_s,
        seed=proposal.seed,
        step_s=step_s,
    )


def free_run_batch(
    commands: Float[np.ndarray, "t n"],
    *,
    dead_zone: float,
    start: float,
    sign: int,
    step_s: float,
    covariates: Mapping[str, float] = NO_COVARIATES,
) -> Batch:
    """Return commands as logged as tests that begin at one displacement, padded as `Batch.of` pads them."""
    tests, samples = commands.shape
    padded = np.pad(commands, ((0, 0), (0, padded_length(samples) - samples)))
    return Batch(
        command=jnp.asarray(effective_command(padded, dead_zone)),
        raw_command=jnp.asarray(padded),
        dead_zone=jnp.full(tests, dead_zone),
        displacement=jnp.full(padded.shape, start),
        valid=jnp.ones(padded.shape, dtype=bool),
        loss_mask=jnp.ones(padded.shape, dtype=bool),
        initial=jnp.full(tests, start),
        covariates=jnp.tile(jnp.array(list(covariates.values()), dtype=float), (tests, 1)),
        step_s=step_s,
        sign=sign,
        covariate_names=tuple(covariates),
    )


def _batch(channel: Channel, commands: Float[np.ndarray, "t n"], step_s: float) -> Batch:
    """Return candidate tests as a batch that starts at the end of the stroke opposite to the motion."""
    ends, load = channel.operating_range.displacement, channel.operating_range.load
    means = map(float, 0.5 * (np.asarray(load.lowest) + np.asarray(load.highest)))
    return free_run_batch(
        precompensated(commands, channel.dead_zone),
        dead_zone=channel.dead_zone,
        # The whole stroke is ahead of it, as it was in the tests.
        start=float(ends.lowest if channel.sign > 0 else ends.highest),
        sign=channel.sign,
        step_s=step_s,
        covariates=dict(zip(channel.benchmark.covariates, means, strict=False)),
    )


def _derivatives(
    channel: Channel, information: Information, batch: Batch
) -> tuple[np.ndarray, Float[np.ndarray, "t n d"]]:
    """Return travel, and its derivatives by the parameters in the unit cube."""
    physical_model = channel.benchmark
    names = [parameter.name for parameter in physical_model.parameters]
    tangents = np.zeros((len(information.names), physical_model.parameter_vector.size))
    for row, name, slope in zip(tangents, information.names, information.slopes, strict=True):
        row[names.index(name)] = slope
    travel, slopes = _travel_derivatives(physical_model, batch, jnp.asarray(tangents))
    return np.asarray(travel), np.moveaxis(np.asarray(slopes), 0, -1)


@eqx.filter_jit
def _travel_derivatives(
    physical_model: PhysicalModel, batch: Batch, tangents: Float[Array, "d r"]
) -> tuple[Float[Array, "t n"], Float[Array, "d t n"]]:

    def travel(row: Array) -> Array:
        return physical_model.with_parameter_vector(row).travel(batch)

    # One parameter after the other: all at once would hold as many free runs of all candidates.
    slopes = jax.lax.map(
        lambda tangent: jax.jvp(travel, (physical_model.parameter_vector,), (tangent,))[1], tangents
    )
    return travel(physical_model.parameter_vector), slopes
