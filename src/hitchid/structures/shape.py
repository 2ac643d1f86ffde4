"""What a linear model leaves out: the valve's opening curve, the gain along the stroke, the load."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from hitchid.structures.structure import Parameter

SHARPNESS = 4
SHUT = 1e-3
CREVICE = 1e-6
REACH = 1.5
FARTHEST = 0.7
LOW_LEVELS = "levels just above the dead zone"
LEVELS = "more levels of command"
HIGH_LEVELS = "higher levels of command"
STROKE = "tests over more of the stroke"
LOADS = "tests at other loads"
CURVE = (
    Parameter("opening", "1", -0.6, 0.9, linear=True, asks=LOW_LEVELS),
    Parameter("exponent", "1", 1 / 3, 3.0, asks=LEVELS),
    Parameter("saturation", "1", 0.05, 1e4, asks=HIGH_LEVELS),
)
SPOOL = (
    Parameter("hysteresis", "1", 0.0, 1.0, linear=True, asks="commands that fall between levels"),
    Parameter("spool_lag", "s", 1e-3, 0.5, symbol="spool lag"),
)
SLOPE = (Parameter("position_slope", "1", -2.0, 2.0, linear=True, asks=STROKE),)
POSITION = (*SLOPE, Parameter("position_curve", "1", -2.0, 2.0, linear=True, asks=STROKE))
LOAD = (
    Parameter("load_shift", "1", -0.3, 0.3, linear=True, asks=LOADS),
    Parameter("load_gain", "1", -1.0, 1.0, linear=True, asks=LOADS),
)
SHAPE = (*CURVE, *SPOOL, *POSITION, *LOAD)
NEUTRAL = {"opening": 0.0, "exponent": 1.0, "saturation": 1e4, "spool_lag": 1e-15}


class Scales(eqx.Module):
    """What the shape's parameters are measured in, taken from the identification tests.

    Attributes:
        command: largest effective command.
        centre, span: middle and half of the range of displacement.
        load_centre, load_spread: mean and standard deviation of the second measured input.
    """

    command: Float[Array, ""]
    centre: Float[Array, ""]
    span: Float[Array, ""]
    load_centre: Float[Array, ""]
    load_spread: Float[Array, ""]


class Spool(NamedTuple):
    """State of a valve's spool, each of any one shape [...].

    Attributes:
        lagged: the command after the lag, s.
        place: the same after play, p.
    """

    lagged: Float[Array, "*b"]
    place: Float[Array, "*b"]


class Shape(eqx.Module):
    """Static curves around a linear model: u → w(u, c) → linear dynamics → gain g(x, c).

    The spool follows the command with a lag, ṡ = (c − s)/τ, and with play: p(k) = p(k−1) held within
    s̄(k) ± h d₀/2, where s̄ is the mean of s over a sampling interval, d₀ the dead zone and h d₀ the width of
    the hysteresis. Beyond the dead zone lies u = sign(p)·max(|p| − d₀ + h d₀/2, 0), which without lag and
    hysteresis is the effective command.

    With z = u/U and the second input c in its own spread, v = max(z − s c − d, 0)ⁿ and
    w = U v/(1 + (v/σ)⁴)^¼: beyond the opening d flow grows with the power n of the command until it
    saturates. Within a millionth of U of its opening flow is a straight line, for a power below one has no
    derivative at zero. A negative opening says that the valve opens below the dead zone. Where u is less than
    a thousandth of U nothing flows: h ≤ 1 and the end of the lag make sure of that for a command of zero.
    Travel grows by g = exp(a ξ + b (ξ² − ⅓) + γ c) times what the linear model's does, ξ the displacement
    within its range; farther out than 1½ of it b ξ² is held, and a ξ goes on to at most twice or half.

    Attributes:
        values: d, n, σ, h, τ, a, b, s, γ, shape [9].
        scales: U, and those of ξ and c.
    """

    values: Float[Array, "9"]
    scales: Scales

    def effective(
        self, logged: Float[Array, "t n"], dead_zone: Float[Array, " t"], step_s: Float[Array, ""] | float
    ) -> Float[Array, "t n"]:
        """Return u, in the command's unit, from the command as logged; before its first sample it is zero."""

        def advance(spool: Spool, command: Array) -> tuple[Spool, Array]:
            return self.follow(spool, command, dead_zone, step_s)

        rest = jnp.zeros_like(logged[:, 0])
        return jax.lax.scan(advance, Spool(rest, rest), logged.T)[1].T

    def follow(
        self,
        spool: Spool,
        command: Float[Array, "*b"],
        dead_zone: Float[Array, "*b"],
        step_s: Float[Array, ""] | float,
    ) -> tuple[Spool, Float[Array, "*b"]]:
        """Let the spool follow the command over one sample; return it, and u in the command's unit."""
        hysteresis, lag = self._named("hysteresis", "spool_lag")
        half = 0.5 * hysteresis * dead_zone
        left = jnp.exp(-step_s / lag)
        mean = command + lag / step_s * (1 - left) * (spool.lagged - command)
        place = jnp.clip(spool.place, mean - half, mean + half)
        beyond = jnp.sign(place) * jnp.maximum(jnp.abs(place) - (dead_zone - half), 0.0)
        return Spool(command + left * (spool.lagged - command), place), beyond

    def flow(self, command: Float[Array, "*b"], load: Float[Array, "*#b"]) -> Float[Array, "*b"]:
        """Return w, in the command's unit.

        Args:
            command: u, what lies beyond the dead zone.
            load: second input before motion.
        """
        opening, exponent, saturation, shift = self._named("opening", "exponent", "saturation", "load_shift")
        size = jnp.abs(command) / self.scales.command
        beyond = size - opening - shift * self._load(load)
        open_ = (size > SHUT) & (beyond > 0)
        power = jnp.maximum(beyond, CREVICE) ** exponent * jnp.minimum(beyond / CREVICE, 1.0)
        grown = jnp.where(open_, power, 0.0)
        limited = grown / (1 + (grown / saturation) ** SHARPNESS) ** (1 / SHARPNESS)
        return jnp.sign(command) * self.scales.command * limited

    def gain(self, displacement: Float[Array, "*b"], load: Float[Array, "*b"]) -> Float[Array, "*b"]:
        """Return g, what the linear model's speed is multiplied by.

        Args:
            displacement: where the piston is.
            load: second input before motion.
        """
        slope, curve, gain = self._named("position_slope", "position_curve", "load_gain")
        place = (displacement - self.scales.centre) / self.scales.span
        near = jnp.clip(place, -REACH, REACH)
        beyond = jnp.clip(slope * (place - near), -FARTHEST, FARTHEST)
        return jnp.exp(slope * near + beyond + curve * (near**2 - 1 / 3) + gain * self._load(load))

    def travel(
        self,
        linear: Float[Array, "t n"],
        load: Float[Array, " t"],
        initial: Float[Array, " t"],
        sign: int | Int[Array, ""],
    ) -> Float[Array, "t n"]:
        """Return travel from the linear model's.

        Args:
            linear: travel of the linear model.
            load: second input before motion.
            initial: displacement before motion.
            sign: +1 where displacement grows with travel, −1 where it falls.
        """
        steps = jnp.diff(linear, axis=1, prepend=jnp.zeros_like(linear[:, :1]))

        def advance(travel: Array, step: Array) -> tuple[Array, Array]:
            travel = travel + self.gain(initial + sign * travel, load) * step
            return travel, travel

        return jax.lax.scan(advance, jnp.zeros_like(initial), steps.T)[1].T

    def _named(self, *names: str) -> tuple[Array, ...]:
        order = [parameter.name for parameter in SHAPE]
        return tuple(self.values[order.index(name)] for name in names)

    def _load(self, load: Float[Array, "*b"]) -> Float[Array, "*b"]:
        return jnp.clip((load - self.scales.load_centre) / self.scales.load_spread, -3.0, 3.0)
