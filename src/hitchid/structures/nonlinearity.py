"""Nonlinearities around a linear model: valve curve, spool dynamics, gain along the stroke."""

from collections.abc import Sequence, Set
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.records import short_repr
from hitchid.structures.limited import limited
from hitchid.structures.structure import LinearStructure, Parameter

# Parameters that vary with measured covariates, such as the pressure before motion or oil temperature.

OPENING = "opening"  # of the valve curve: shifted, where the other quantities are multiplied
MAX_SPREADS = 3.0  # standard deviations of a covariate beyond which it has no further effect; chosen
MAX_QUADRATIC_SPREADS = 2.0  # the same for its square: about the range of twenty tests; chosen
POWERS = (1, 2)  # of a covariate
# Change per standard deviation: of the logarithm of a speed up to a factor of e, of the logarithm of a
# dynamic parameter (oil is ten times as viscous at 5 °C as at 70 °C), of an opening in largest commands.
MAX_SPEED_EFFECT, MAX_DYNAMIC_EFFECT, MAX_SHIFT = 1.0, 1.5, 0.3
LOADS = "tests at other values of the covariate"


@short_repr
@dataclass(frozen=True)
class CovariateEffects:
    """What one covariate changes.

    Attributes:
        covariate: name of the measured input.
        dynamics: whether it changes the dynamics beside the speed and the opening of the valve.
        quadratic: whether its square does, too.
    """

    covariate: str
    dynamics: bool = False
    quadratic: bool = False

    def parameters(self, structure: LinearStructure) -> tuple[Parameter, ...]:
        """Return the parameters that are identified for a structure."""
        quantities = scheduled_quantities(structure) if self.dynamics else (structure.gain, OPENING)
        powers = POWERS if self.quadratic else POWERS[:1]
        return tuple(
            effect_parameter(structure, quantity, self.covariate, power)
            for power in powers
            for quantity in quantities
        )

    def limited_to(self, structure: LinearStructure, names: Set[str]) -> "CovariateEffects":
        """Return the fewest effects of the covariate among which are those named."""

        def has_all(effects: "CovariateEffects") -> bool:
            return needed <= {parameter.name for parameter in effects.parameters(structure)}

        needed = names & {parameter.name for parameter in self.parameters(structure)}
        all_effects = [
            CovariateEffects(self.covariate, dynamics, quadratic)
            for quadratic in (False, True)
            for dynamics in (False, True)
        ]
        return next(effects for effects in all_effects if has_all(effects))


class CovariateScales(eqx.Module):
    """Scales of the covariates, taken from the identification tests.

    Attributes:
        centre, spread: mean and standard deviation, shape [C].
    """

    centre: Float[Array, " c"]
    spread: Float[Array, " c"]

    @classmethod
    def none(cls) -> "CovariateScales":
        """Return the scales of no covariates."""
        return cls(jnp.zeros(0), jnp.zeros(0))


@short_repr
class Scheduling(eqx.Module):
    """Effects of covariates c on the parameters of a model: θ(c) = θ·exp(β₁ᵀz + β₂ᵀz²), z = (c − c̄)/σ.

    The opening of the valve is shifted by β₁ᵀz + β₂ᵀz² instead. z is limited at ±3, in z² at ±2.

    Attributes:
        covariates: names of the measured inputs, C of them.
        quantities: names of the parameters that vary, P of them.
        effects: β₁ and β₂, shape [P, C, 2].
    """

    covariates: tuple[str, ...] = eqx.field(static=True)
    quantities: tuple[str, ...] = eqx.field(static=True)
    effects: Float[Array, "p c 2"]

    def changes(self, load: Float[Array, " c"], scales: CovariateScales) -> Float[Array, " p"]:
        """Return β₁ᵀz + β₂ᵀz² of each quantity.

        Args:
            load: the covariates, in their units.
            scales: of the covariates.
        """
        scaled = (load - scales.centre) / scales.spread
        linear = jnp.clip(scaled, -MAX_SPREADS, MAX_SPREADS)
        square = jnp.clip(scaled, -MAX_QUADRATIC_SPREADS, MAX_QUADRATIC_SPREADS) ** 2
        return self.effects[..., 0] @ linear + self.effects[..., 1] @ square


def scheduled_quantities(structure: LinearStructure) -> tuple[str, ...]:
    """Return the names of the parameters that may vary with a covariate."""
    return (structure.gain, *structure.load_dynamics, OPENING)


def effect_parameter(structure: LinearStructure, quantity: str, covariate: str, power: int) -> Parameter:
    """Return the parameter of one effect, such as `gain_by_head_pressure`."""
    limits = {structure.gain: MAX_SPEED_EFFECT, OPENING: MAX_SHIFT}
    limit = limits.get(quantity, MAX_DYNAMIC_EFFECT)
    name = f"{quantity}_by_{covariate}" + ("_squared" if power > 1 else "")
    return Parameter(name, "1", -limit, limit, linear=True, excitation_hint=LOADS)


def effect_parameters(structure: LinearStructure, covariates: Sequence[str]) -> tuple[Parameter, ...]:
    """Return the parameters of all effects, in the order of `Scheduling.effects`."""
    return tuple(
        effect_parameter(structure, quantity, covariate, power)
        for quantity in scheduled_quantities(structure)
        for covariate in covariates
        for power in POWERS
    )


# Commands are in shares of U, the largest effective command, displacements in half ranges from their centre.
SHARPNESS = 4  # power of the saturation curve: the larger, the sharper its corner
MIN_RELATIVE_COMMAND = 1e-3  # share of U below which the valve is closed; see `StaticNonlinearity`
RELATIVE_STEP = 1e-12  # beyond that share, so that rounding does not close the valve again
LINEAR_OPENING = 1e-6  # share of U above the opening within which flow is a straight line
QUADRATIC_RANGE = 1.5  # half ranges beyond which the quadratic term is held: half as far as was measured
MAX_EXTRAPOLATION = 0.7  # ln 2: farther out the gain changes by a factor of two at most
# What a test must contain to determine a parameter.
LOW_LEVELS = "levels just above the dead zone"
LEVELS = "more levels of command"
HIGH_LEVELS = "higher levels of command"
STROKE = "tests over more of the stroke"
VALVE_CURVE = (
    Parameter("opening", "1", -0.6, 0.9, linear=True, excitation_hint=LOW_LEVELS),
    Parameter("exponent", "1", 1 / 3, 3.0, excitation_hint=LEVELS),
    Parameter("saturation", "1", 0.05, 1e4, excitation_hint=HIGH_LEVELS),
)
SPOOL_DYNAMICS = (
    Parameter(
        "hysteresis", "1", 0.0, 1.0, linear=True, excitation_hint="commands that decrease between levels"
    ),
    Parameter("spool_lag", "s", 1e-3, 0.5, symbol="spool lag"),
)
STROKE_GAIN_LINEAR = (Parameter("position_slope", "1", -2.0, 2.0, linear=True, excitation_hint=STROKE),)
STROKE_GAIN_QUADRATIC = (
    *STROKE_GAIN_LINEAR,
    Parameter("position_curve", "1", -2.0, 2.0, linear=True, excitation_hint=STROKE),
)
NONLINEARITY_PARAMETERS = (*VALVE_CURVE, *SPOOL_DYNAMICS, *STROKE_GAIN_QUADRATIC)
NEUTRAL = {"opening": 0.0, "exponent": 1.0, "saturation": 1e4, "spool_lag": 1e-15}


@short_repr
class Scales(eqx.Module):
    """Scales of the nonlinearities' parameters, taken from the identification tests.

    Attributes:
        command: largest effective command.
        centre, span: middle and half of the range of displacement.
        covariates: of the covariates that parameters vary with.
    """

    command: Float[Array, ""]
    centre: Float[Array, ""]
    span: Float[Array, ""]
    covariates: CovariateScales = eqx.field(default_factory=CovariateScales.none)


class PlayState(NamedTuple):
    """State of a valve's spool, each of any one shape [...].

    Attributes:
        lagged: the command after the lag, s.
        play_output: the same after play, p.
    """

    lagged: Float[Array, "*b"]
    play_output: Float[Array, "*b"]


@short_repr
class StaticNonlinearity(eqx.Module):
    """Static curves around a linear model: u → w(u) → linear dynamics → gain g(x).

    The spool follows the command with a lag, ṡ = (c − s)/τ, and with play: p(k) = p(k−1) held within
    s̄(k) ± h d₀/2, where s̄ is the mean of s over a sampling interval, d₀ the dead zone and h d₀ the width of
    the hysteresis. Beyond the dead zone lies u = sign(p)·max(abs(p) − d₀ + h d₀/2, 0), which without lag and
    hysteresis is the effective command.

    With z = u/U, v = max(z − d, 0)ⁿ, f = v/(1 + (v/σ)⁴)^¼ and w = U f/f₁: beyond the opening d flow grows
    with the power n of the command until it saturates. f₁ is f at z = 1, so that the gain of the linear
    model is the speed at the largest command, per command. Within a millionth of U of its opening flow is a
    straight line, for a power below one has no derivative at zero. With a negative opening the valve opens
    below the dead zone. Where u is less than a thousandth of U nothing flows; with h ≤ 1 that includes a
    command of zero once the lag has died away. Travel grows by g = exp(a ξ + b (ξ² − ⅓)) times what the
    linear model's does, ξ the displacement within its range; farther out than 1½ of it b ξ² is held, and a ξ
    goes on to at most twice or half.

    Attributes:
        values: d, n, σ, h, τ, a, b, shape [7].
        scales: U, and those of ξ.
    """

    values: Float[Array, "7"]
    scales: Scales

    def effective(
        self,
        raw_command: Float[Array, "t n"],
        dead_zone: Float[Array, " t"],
        step_s: Float[Array, ""] | float,
    ) -> Float[Array, "t n"]:
        """Return u, in the command's unit, from the command as logged, zero before its first sample."""

        def advance(spool: PlayState, command: Array) -> tuple[PlayState, Array]:
            return self.step_spool(spool, command, dead_zone, step_s)

        zeros = jnp.zeros_like(raw_command[:, 0])
        return jax.lax.scan(advance, PlayState(zeros, zeros), raw_command.T)[1].T

    def step_spool(
        self,
        spool: PlayState,
        command: Float[Array, "*b"],
        dead_zone: Float[Array, "*b"],
        step_s: Float[Array, ""] | float,
    ) -> tuple[PlayState, Float[Array, "*b"]]:
        """Advance the spool by one sample; return it, and u in the command's unit."""
        hysteresis, lag = self.named("hysteresis", "spool_lag")
        half_width = 0.5 * hysteresis * dead_zone
        decay = jnp.exp(-step_s / lag)
        mean_lagged = command + lag / step_s * (1 - decay) * (spool.lagged - command)
        play_output = limited(spool.play_output, mean_lagged - half_width, mean_lagged + half_width)
        excess = jnp.sign(play_output) * limited(jnp.abs(play_output) - (dead_zone - half_width), 0.0)
        return PlayState(command + decay * (spool.lagged - command), play_output), excess

    def flow(self, command: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return w, in the command's unit.

        Args:
            command: u, what lies beyond the dead zone.
        """
        size = jnp.abs(command) / self.scales.command
        above_opening = size - self.named("opening")[0]
        is_open = (size > MIN_RELATIVE_COMMAND) & (above_opening > 0)
        share = jnp.where(is_open, self._share(above_opening), 0.0) / self.largest_share
        return jnp.sign(command) * self.scales.command * share

    @property
    def largest_share(self) -> Float[Array, ""]:
        """f₁, what f is at the largest command."""
        return self._share(limited(1 - self.named("opening")[0], LINEAR_OPENING))

    def _share(self, above_opening: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return f of z − d > 0."""
        exponent, saturation = self.named("exponent", "saturation")
        power = limited(above_opening, LINEAR_OPENING) ** exponent
        power *= limited(above_opening / LINEAR_OPENING, highest=1.0)
        return power / (1 + (power / saturation) ** SHARPNESS) ** (1 / SHARPNESS)

    @property
    def opening_command(self) -> Float[Array, ""]:
        """U max(d, 0), where beyond the dead zone flow begins, in the command's unit."""
        return self.scales.command * jnp.maximum(self.named("opening")[0], 0.0)

    @property
    def smallest_command(self) -> Float[Array, ""]:
        """Smallest u at which the valve opens, in the command's unit, where its opening is not larger."""
        return MIN_RELATIVE_COMMAND * (1 + RELATIVE_STEP) * self.scales.command

    def command_for_flow(self, flow: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return u > 0 of a flow w > 0, the inverse of `flow`, in the command's unit.

        Not finite for a flow that saturation does not let through.
        """
        opening, exponent, saturation = self.named("opening", "exponent", "saturation")
        saturated = flow / self.scales.command * self.largest_share
        unsaturated = saturated / (1 - (saturated / saturation) ** SHARPNESS) ** (1 / SHARPNESS)
        straight = LINEAR_OPENING ** (1 - exponent) * unsaturated
        above_opening = jnp.maximum(unsaturated, 0.0) ** (1 / exponent)
        above_opening = jnp.where(above_opening < LINEAR_OPENING, straight, above_opening)
        return self.scales.command * (above_opening + opening)

    def gain(self, displacement: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return g, the factor on the linear model's speed.

        Args:
            displacement: where the piston is.
        """
        slope, curve = self.named("position_slope", "position_curve")
        position = self.position(displacement)
        clipped_position = limited(position, -QUADRATIC_RANGE, QUADRATIC_RANGE)
        extrapolation = limited(slope * (position - clipped_position), -MAX_EXTRAPOLATION, MAX_EXTRAPOLATION)
        return jnp.exp(slope * clipped_position + extrapolation + curve * (clipped_position**2 - 1 / 3))

    def position(self, displacement: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return ξ, half ranges of displacement from the middle of its range."""
        return (displacement - self.scales.centre) / self.scales.span

    def with_opening_shifted(self, shift: Float[Array, ""]) -> "StaticNonlinearity":
        """Return the curves with d + s in place of d, s a share of U."""
        number = [parameter.name for parameter in NONLINEARITY_PARAMETERS].index(OPENING)
        return StaticNonlinearity(self.values.at[number].add(shift), self.scales)

    def named(self, *names: str) -> tuple[Array, ...]:
        """Return values by the names of their parameters."""
        order = [parameter.name for parameter in NONLINEARITY_PARAMETERS]
        return tuple(self.values[order.index(name)] for name in names)
