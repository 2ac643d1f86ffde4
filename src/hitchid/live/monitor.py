"""Predictions beside a running machine: the free run since a start, and a horizon ahead, with bands."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.records import short_repr
from hitchid.errors import InputError
from hitchid.live.parameters import adjusted_state
from hitchid.model import (
    Hitch,
    HitchDynamics,
    HitchState,
    Load,
    bands_by_channel,
    ensemble_half_width,
    ensemble_members,
    load_row,
)


@short_repr
class Predictions(NamedTuple):
    """Predictions over a block of samples, in the model's unit; half widths are NaN without bands.

    Attributes:
        free_run: displacement at each sample, from the commands since the start alone, shape [B].
        free_run_half_width: of its band, shape [B].
        ahead: displacement a horizon after the last sample of the block, with its commands held.
        ahead_half_width: of its band.
    """

    free_run: Float[np.ndarray, " b"]
    free_run_half_width: Float[np.ndarray, " b"]
    ahead: float
    ahead_half_width: float


class Monitor:
    """A model beside a running machine, block by block of samples of equal number.

    Args:
        model: identified hitch.
        displacement: at the start, where the hitch is at rest, in the model's unit.
        block: B, samples of a block; each number is compiled once.
        horizon_s: of the prediction ahead, s.
        coverage: of the bands, share of samples.
        load: covariate before motion, or several by name; by default the mean of the tests.

    Raises:
        InputError: an argument is invalid.
    """

    @double_precision
    def __init__(
        self,
        model: Hitch,
        displacement: float,
        *,
        block: int = 4,
        horizon_s: float = 1.0,
        coverage: float = 0.9,
        load: Load | None = None,
    ) -> None:
        self.block = checks.integer(block, "block", minimum=1)
        self.horizon = max(1, round(checks.number(horizon_s, "horizon_s", above=0.0) / model.step_s))
        self._coverage = checks.number(coverage, "coverage")
        self._load = jnp.asarray(load_row(load, tuple(model.channels.values()), "model"))
        self._dynamics, self._groups = self._parts(model)
        self.restart(displacement)

    @double_precision
    def restart(self, displacement: float) -> None:
        """Start the free run anew at a displacement at rest, in the model's unit."""
        # Not weakly typed: one compilation.
        start = jnp.asarray(checks.number(displacement, "displacement"), float)
        self._state = self._dynamics.init_state(start, self._load)
        self._runs = [_started(stacked, start, self._load) for _, stacked in self._groups]

    @double_precision
    def adjust(self, model: Hitch) -> None:
        """Go on with the model, adapted in gains, dead zones and bands; nothing is compiled anew."""
        dynamics, groups = self._parts(model)
        self._dynamics = _with_models_of(self._dynamics, dynamics)
        self._groups = [
            (indices, _with_models_of(stacked, adapted))
            for (indices, stacked), (_, adapted) in zip(self._groups, groups, strict=True)
        ]
        self._state = _adjusted(self._dynamics, self._state)
        self._runs = [
            _adjusted_runs(stacked, states)
            for (_, stacked), states in zip(self._groups, self._runs, strict=True)
        ]

    def _parts(self, model: Hitch) -> tuple[HitchDynamics, list[tuple[list[int], HitchDynamics]]]:
        """Return the dynamics of predictions, and those of the free runs in groups; keep the bands."""
        free_run_dynamics = model.free_run_dynamics()
        self._bands = bands_by_channel(model.bands, tuple(model.channels)) if model.has_bands else []
        self._members = ensemble_members(free_run_dynamics, self._bands) if self._bands else []
        return model.dynamics, _grouped([free_run_dynamics, *(member.dynamics for member in self._members)])

    @double_precision
    def advance(self, commands: np.ndarray, measured: np.ndarray) -> Predictions:
        """Return the predictions of the next block.

        Args:
            commands: lifting and lowering, each until the next sample, in the model's unit, shape [B, 2].
            measured: displacement, NaN where there is none, in the model's unit, shape [B].

        Raises:
            InputError: the block has another number of samples.
        """
        if np.shape(commands) != (self.block, 2) or np.shape(measured) != (self.block,):
            raise InputError(
                f"commands, measured: expected shapes ({self.block}, 2) and ({self.block},), got "
                f"{np.shape(commands)} and {np.shape(measured)}"
            )
        rows = np.empty((1 + len(self._members), self.block))
        for number, (indices, stacked) in enumerate(self._groups):
            self._runs[number], displacement = _advance(stacked, self._runs[number], jnp.asarray(commands))
            rows[indices] = displacement
        self._state, ahead = _ahead(
            self._dynamics, self._state, jnp.asarray(commands), jnp.asarray(measured), self.horizon
        )
        half_width, ahead_half_width = np.full(self.block, np.nan), np.nan
        if self._bands:  # of the ensemble's runs about that of the model, the first row
            half_width = ensemble_half_width(self._members, self._bands, rows[1:] - rows[0], self._coverage)
            valid = measured[np.isfinite(measured)]
            if valid.size:
                bands, moved = self._bands[max(int(self._state.mode), 0)], float(ahead) - valid[-1]
                ahead_half_width = float(bands.half_width(self._coverage, self.horizon, np.asarray(moved)))
        return Predictions(rows[0], half_width, float(ahead), ahead_half_width)


def _grouped(dynamics: Sequence[HitchDynamics]) -> list[tuple[list[int], HitchDynamics]]:
    """Return the hitches stacked in groups of one structure, with their numbers."""
    # One call a group instead of one a hitch; a hitch with other networks is another program.
    groups: dict[object, list[int]] = {}
    for number, own in enumerate(dynamics):
        groups.setdefault(jax.tree.structure(own), []).append(number)
    return [
        (indices, jax.tree.map(lambda *leaves: np.stack(leaves), *(dynamics[number] for number in indices)))
        for indices in groups.values()
    ]


def _with_models_of(dynamics: HitchDynamics, adapted: HitchDynamics) -> HitchDynamics:
    """Return dynamics with the physical models of others; what the compiled functions depend on stays."""
    return eqx.tree_at(lambda tree: tree.discrete_models, dynamics, adapted.discrete_models)


_adjusted = eqx.filter_jit(adjusted_state)
_adjusted_runs = eqx.filter_jit(eqx.filter_vmap(adjusted_state))


@eqx.filter_jit
def _started(stacked: HitchDynamics, displacement: Array, load: Array) -> HitchState:
    return jax.vmap(lambda dynamics: dynamics.init_state(displacement, load))(stacked)


@eqx.filter_jit
def _advance(
    stacked: HitchDynamics, states: HitchState, commands: Float[Array, "b 2"]
) -> tuple[HitchState, Float[Array, "a b"]]:
    """Return the states after a block, and the displacement at each of its samples, of every hitch."""

    def run(dynamics: HitchDynamics, state: HitchState) -> tuple[HitchState, Array]:
        def advance(state: HitchState, command: Array) -> tuple[HitchState, Array]:
            return dynamics.step(state, command, jnp.asarray(jnp.nan))[0], state.displacement

        return jax.lax.scan(advance, state, commands)

    return jax.vmap(run)(stacked, states)


@eqx.filter_jit
def _ahead(
    dynamics: HitchDynamics,
    state: HitchState,
    commands: Float[Array, "b 2"],
    measured: Float[Array, " b"],
    horizon: int,
) -> tuple[HitchState, Float[Array, ""]]:
    """Return the state after a block, and the displacement `horizon` samples after its last sample."""

    def advance(state: HitchState, inputs: tuple[Array, Array]) -> tuple[HitchState, None]:
        return dynamics.step(state, *inputs)[0], None

    state, _ = jax.lax.scan(advance, state, (commands, measured))

    def coast(_: Array, later: HitchState) -> HitchState:
        return dynamics.step(later, commands[-1], jnp.asarray(jnp.nan))[0]

    return state, jax.lax.fori_loop(1, horizon, coast, state).displacement
