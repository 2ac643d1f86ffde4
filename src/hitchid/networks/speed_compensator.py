"""Compensator for free run: small networks that scale the speed of the benchmark.

The compensator of Sun et al. 2025, sec. 2.2.3, takes the measured displacement; this one its own output.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid.networks.operating_range import OperatingRange, SignalRange

SPEED_AUTHORITY = 0.5  # largest relative correction of the speed; chosen
SIGNALS = 4  # command, speed and acceleration of the benchmark, displacement; covariates follow
DISPLACEMENT = 3  # index of the input that the networks feed back


class SpeedNetworks(NamedTuple):
    """M networks of one layer of H units each, f = v · tanh(W x + b).

    Attributes:
        input_weights: W, shape [M, H, 4 + C].
        biases: b, shape [M, H].
        output_weights: v, shape [M, H].
    """

    input_weights: Float[Array, "m h i"]
    biases: Float[Array, "m h"]
    output_weights: Float[Array, "m h"]


class SpeedCompensator(eqx.Module):
    """Networks that scale the speed of the benchmark by 1 ± ½.

    y(k+1) = y(k) + (y_tf(k+1) − y_tf(k)) (1 + ½ m(k) Σᵢ tanh fᵢ(x(k))/M). x: effective command, speed and
    acceleration of the benchmark up to sample k, the compensated displacement, and the covariates. m: trust
    factor, 1 within the operating range of the tests. While the benchmark is at standstill, so is the output.

    Attributes:
        networks: the networks fᵢ.
        command_scale, speed_scale, acceleration_scale: scales of the inputs, shape [].
        operating_range: ranges of the signals in the identification tests.
        sign: +1 where displacement grows with travel, −1 where it falls.
    """

    networks: SpeedNetworks
    command_scale: Float[Array, ""]
    speed_scale: Float[Array, ""]
    acceleration_scale: Float[Array, ""]
    operating_range: OperatingRange
    sign: int = eqx.field(static=True)

    @property
    def members(self) -> int:
        """Number of networks, M."""
        return self.networks.biases.shape[0]

    def inputs(
        self, command: Array, speed: Array, acceleration: Array, displacement: Array, load: Array
    ) -> Float[Array, "*b i"]:
        """Return the scaled inputs of the networks."""
        loads = _centred(load, self.operating_range.load)
        scaled = [
            command / self.command_scale,
            speed / self.speed_scale,
            acceleration / self.acceleration_scale,
            _centred(displacement, self.operating_range.displacement),
            *jnp.moveaxis(loads, -1, 0),
        ]
        return jnp.stack(jnp.broadcast_arrays(*scaled), axis=-1)

    def factor(
        self,
        command: Float[Array, "*b"],
        speed: Float[Array, "*b"],
        acceleration: Float[Array, "*b"],
        displacement: Float[Array, "*b"],
        load: Float[Array, "*b c"],
    ) -> Float[Array, "*b"]:
        """Return the factor on the benchmark's speed until the next sample.

        Speed and acceleration are those of the benchmark's travel; the displacement is compensated.
        """
        scaled = self.inputs(command, speed, acceleration, displacement, load)
        trust = self.operating_range.trust(jnp.abs(command), displacement, load)
        return 1 + SPEED_AUTHORITY * trust * _mean_output(
            self.networks, _preactivation(self.networks, scaled)
        )


@eqx.filter_jit
def simulate_compensated(
    compensator: SpeedCompensator,
    benchmark: Float[Array, "t n"],
    command: Float[Array, "t n"],
    initial: Float[Array, " t"],
    load: Float[Array, "t c"],
    step_s: Float[Array, ""] | float,
) -> Float[Array, "t n"]:
    """Return the travel of the compensated free run from that of the benchmark, shape [T, N]."""
    networks, operating_range = compensator.networks, compensator.operating_range
    increment = jnp.diff(benchmark, axis=1, append=benchmark[:, -1:])
    speed = _delayed(increment) / step_s
    acceleration = (speed - _delayed(speed)) / step_s
    # All that does not depend on the compensated displacement is computed for all samples at once.
    scaled = compensator.inputs(command, speed, acceleration, initial[:, None], load[:, None])
    fixed = _preactivation(networks, scaled.at[..., DISPLACEMENT].set(0.0))
    trust = operating_range.command.trust(jnp.abs(command)) * operating_range.load_trust(load)[:, None]

    def advance(travel: Array, sample: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        fixed, trust, increment = sample
        displacement = initial + compensator.sign * travel
        position = _centred(displacement, operating_range.displacement)[:, None, None]
        output = _mean_output(networks, fixed + networks.input_weights[..., DISPLACEMENT] * position)
        trust = trust * operating_range.displacement.trust(displacement)
        return travel + (1 + SPEED_AUTHORITY * trust * output) * increment, travel

    samples = (jnp.swapaxes(fixed, 0, 1), trust.T, increment.T)
    return jax.lax.scan(advance, jnp.zeros_like(initial), samples)[1].T


def _preactivation(networks: SpeedNetworks, scaled: Float[Array, "*b i"]) -> Float[Array, "*b m h"]:
    """Return W x + b of all networks."""
    return jnp.sum(networks.input_weights * scaled[..., None, None, :], axis=-1) + networks.biases


def _mean_output(networks: SpeedNetworks, preactivation: Float[Array, "*b m h"]) -> Float[Array, "*b"]:
    """Return Σᵢ tanh(vᵢ · tanh(W x + b)ᵢ)/M, between −1 and 1."""
    outputs = jnp.sum(networks.output_weights * jnp.tanh(preactivation), axis=-1)
    return jnp.mean(jnp.tanh(outputs), axis=-1)


def _centred(values: Array, signal_range: SignalRange) -> Array:
    """Return values as −1 to 1 over a range; 0 at the middle of a range without width."""
    width = signal_range.highest - signal_range.lowest
    middle = 0.5 * (signal_range.lowest + signal_range.highest)
    return jnp.where(width > 0, 2 * (values - middle) / jnp.where(width > 0, width, 1.0), 0.0)


def _delayed(rows: Float[Array, "t n"]) -> Float[Array, "t n"]:
    return jnp.pad(rows, ((0, 0), (1, 0)))[:, :-1]
