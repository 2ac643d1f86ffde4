"""A hitch whose covariates are not measured: a model for each of many loads, weighted by its predictions."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hitchid._support.short_repr import short_repr
from hitchid.model.dynamics import MAX_MAGNITUDE, HitchDynamics
from hitchid.model.error_prediction import clip_at_end_stops
from hitchid.model.load_filter import JUMP, TINY
from hitchid.model.loads import channel_load, mean_load
from hitchid.model.state import ChannelState, HitchState

LOADS_LOG2 = 7  # 128 loads: of two covariates neighbours are a third of a standard deviation apart; chosen
HALF_WIDTH = 3**0.5  # standard deviations: that of a uniform distribution is its half width over √3


@short_repr
class LoadBankState(NamedTuple):
    """State of one hitch at B loads.

    Attributes:
        hitches: state at each load, arrays of shape [B, ...].
        log_weights: logarithm of the probability of each load, but for a constant, shape [B].
    """

    hitches: HitchState
    log_weights: Float[Array, " b"]

    @property
    def displacement(self) -> Float[Array, ""]:
        """Expected displacement, in the model's unit."""
        return jnp.sum(jax.nn.softmax(self.log_weights) * self.hitches.displacement)

    @property
    def most_probable(self) -> HitchState:
        """State at the most probable load, with the expected displacement."""
        best = jnp.argmax(self.log_weights)
        state = jax.tree.map(lambda leaf: leaf[best], self.hitches)
        return state._replace(displacement=self.displacement)


class LoadBank(eqx.Module):
    """A hitch at many loads, of which the measured displacement shows the probable ones.

    A model with its load filter runs at each of B loads. The probability w of a load follows from the
    displacements y that were measured (multiple-model estimation; Magill 1965, IEEE TAC 10(4), 434-439)::

        log w(k+1) = log w(k) − ½ (log S + ε²/S),   ŷ = Σ w ŷ(load) / Σ w

    with the error ε of the prediction by the filter at that load, and its variance S. A displacement that is
    a jump to the filters at all loads says nothing of the load; see `LoadFilter.correct`. Before motion all
    loads are equally probable. They are those of a uniform distribution with the mean and the standard
    deviations of the identification tests, evenly spread (Sobol 1967), of each channel's own tests: a
    pressure at rest differs between the ends of the stroke.

    Attributes:
        dynamics: of the hitch.
    """

    dynamics: HitchDynamics

    def init_state(self, displacement: Float[Array, ""], load: Float[Array, " l"]) -> LoadBankState:
        """Return the state of a hitch at rest with closed valves.

        Args:
            displacement: where the piston is.
            load: the covariates, in the order of `covariates_of`; NaN for those that are not measured.
        """
        means = jnp.asarray(mean_load(self.dynamics.channels))
        state = self.dynamics.init_state(displacement, jnp.where(jnp.isnan(load), means, load))
        from scipy.stats import qmc  # where it is needed: a model is loaded without it

        points = jnp.asarray(qmc.Sobol(load.size, scramble=False).random_base2(LOADS_LOG2))
        centred = 2 * points - 1 + 1 / len(points)

        def at_point(point: Float[Array, " l"]) -> HitchState:
            channels = (
                self._at_point(number, channel_state, displacement, load, point)
                for number, channel_state in enumerate(state.channels)
            )
            return state._replace(channels=tuple(channels))

        return LoadBankState(jax.vmap(at_point)(centred), jnp.zeros(len(points)))

    def step(
        self, state: LoadBankState, commands: Float[Array, "2"], measured: Float[Array, ""]
    ) -> tuple[LoadBankState, Float[Array, ""]]:
        """Return the state and the expected displacement at the next sample; see `HitchDynamics.step`."""
        variance, error = jax.vmap(self._prediction_error, in_axes=(0, None))(state.hitches, measured)
        tells_load = (jnp.abs(measured) < MAX_MAGNITUDE) & (jnp.min(error**2 / variance) <= JUMP**2)
        likelihood = -0.5 * (jnp.log(variance) + error**2 / variance)
        log_weights = state.log_weights + jnp.where(tells_load, likelihood, 0.0)
        hitches, _ = jax.vmap(self.dynamics.step, in_axes=(0, None, None))(state.hitches, commands, measured)
        next_state = LoadBankState(hitches, log_weights - jnp.max(log_weights))
        return next_state, next_state.displacement

    def _at_point(
        self,
        number: int,
        channel_state: ChannelState,
        displacement: Float[Array, ""],
        load: Float[Array, " l"],
        point: Float[Array, " l"],
    ) -> ChannelState:
        """Return the state of a channel where what is not measured is at a point between −1 and 1."""
        channels, model = self.dynamics.channels, self.dynamics.discrete_models[number]
        nonlinearity = model.benchmark.nonlinearity
        if not model.is_scheduled or nonlinearity is None:
            return channel_state
        scales = nonlinearity.scales.covariates
        measured, part = (channel_load(channels, number, row) for row in (load, point))
        assumed = scales.centre + HALF_WIDTH * scales.spread * part
        at_load = model.at_load(jnp.where(jnp.isnan(measured), assumed, measured))
        plant = at_load.init_state(displacement, jnp.zeros(()))
        return channel_state._replace(at_load=at_load, plant=plant)

    def _prediction_error(
        self, state: HitchState, measured: Float[Array, ""]
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return variance and error of the displacement that the filter of the active channel expects."""
        channels, active = self.dynamics.channels, jnp.maximum(state.mode, 0)
        noise = jnp.stack([channel.load_filter.noise for channel in channels])[active]
        expected = clip_at_end_stops(channels, state, state.benchmark) + state.estimates.error[active]
        return jnp.maximum(state.estimates.variance[active] + noise**2, TINY), measured - expected
