"""Black-box LSTM from command, load and its own displacement to speed, an ensemble trained on free runs."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Float32

from hitchid.baselines.baseline import Baseline, FitContext, Sizes
from hitchid.baselines.block_signals import (
    STEPS,
    BlockSignals,
    block_signals,
    step_samples,
    travel_at_samples,
)
from hitchid.baselines.ensemble_training import Sections, train_ensemble
from hitchid.baselines.fitted import FittedBaseline
from hitchid.baselines.integrating_lstm import SINGLE, IntegratingLstm
from hitchid.baselines.linear_inputs import covariate_scaling, covariates_of
from hitchid.errors import FitError
from hitchid.estimation.training import weight_shapes, weights_of, with_weights
from hitchid.structures import Batch, validation_mask

HIDDEN, MEMBERS = 16, 5  # cells of an LSTM, LSTMs of an ensemble; chosen
SCALINGS = (
    "command_scale",
    "load_centre",
    "load_scale",
    "position_centre",
    "position_scale",
    "increment_scale",
)
MAX_TESTS = 48  # tests of a training, which bound its time; chosen


class BlackBox(FittedBaseline):
    """Ensemble of LSTMs, each in a loop with an integrator; no other physics.

    The mean of the positions that the members simulate from the start of a test. The inputs of a member are
    the command, the load before motion and its own position, see `IntegratingLstm`.

    Attributes:
        networks: the members, a leading axis over them in each array.
        command_scale: largest command of the tests, shape [].
        load_centre, load_scale: scaling of the covariates before motion, shape [C].
        position_centre, position_scale: scaling of the position, shape [].
        increment_scale: σ, mean change of the scaled position in a step, shape [].
        samples: samples of a step, shape [].
    """

    networks: IntegratingLstm
    command_scale: np.ndarray
    load_centre: np.ndarray
    load_scale: np.ndarray
    position_centre: np.ndarray
    position_scale: np.ndarray
    increment_scale: np.ndarray
    samples: np.ndarray

    @classmethod
    def untrained(cls, batch: Batch, signals: BlockSignals, samples: int, seed: int) -> "BlackBox":
        """Return an ensemble that stands still, scaled to tests."""
        rng = np.random.default_rng(seed)
        inputs = 2 * STEPS + covariates_of(batch).shape[1]
        members = [IntegratingLstm.init(rng, inputs, HIDDEN, STEPS) for _ in range(MEMBERS)]
        position = batch.sign * np.asarray(batch.initial)
        scale = np.abs(signals.travel[signals.mask]).max(initial=0.0) or 1.0
        changes = np.diff(signals.travel, axis=2)[signals.mask[:, :, 1:]]
        return cls(
            jax.tree.map(lambda *arrays: jnp.stack(arrays), *members),
            *map(
                np.asarray,
                (
                    np.abs(batch.raw_command).max() or 1.0,
                    *covariate_scaling(batch),
                    position.mean(),
                    scale,
                    (np.abs(changes).mean() if changes.size else 0.0) / scale or 1.0,
                    samples,
                ),
            ),
        )

    def inputs(self, batch: Batch, signals: BlockSignals) -> Float32[Array, "k t i"]:
        """Return the scaled inputs of each block, shape [K, T, 16 + C]."""
        blocks, tests = signals.travel.shape[:2]
        load = (covariates_of(batch) - self.load_centre) / self.load_scale
        commands = (signals.commands / self.command_scale).reshape(blocks, tests, -1)
        load_rows = np.broadcast_to(load[None], (blocks, *load.shape))
        return jnp.asarray(np.concatenate([commands, load_rows], axis=2), SINGLE)

    def start(self, batch: Batch) -> Float32[Array, " t"]:
        """Return the scaled position before motion, shape [T]."""
        position = batch.sign * np.asarray(batch.initial)
        return jnp.asarray((position - self.position_centre) / self.position_scale, SINGLE)

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return displacement simulated from commands and initial displacement, shape [T, N]."""
        samples = int(self.samples)
        signals = block_signals(batch, samples, np.asarray(batch.loss_mask))
        start = self.start(batch)
        scale = jnp.asarray(self.increment_scale, SINGLE)
        positions = mean_positions(self.networks, self.inputs(batch, signals), start, scale)
        travel = self.position_scale * np.asarray(positions - start[None, :, None], np.float64)
        rows = travel_at_samples(travel, samples, batch.command.shape[1])
        return np.asarray(batch.initial)[:, None] + batch.sign * rows

    def predict(self, batch: Batch, horizons: Sequence[int]) -> None:
        """Return None: the model only simulates; it takes no measured displacement after the start."""


class BlackBoxBaseline(Baseline):
    """Ensemble of five black-box LSTMs trained on whole free runs."""

    name, title = "lstm", "black-box LSTM"

    def fit(self, tests: Batch, context: FitContext) -> BlackBox:
        """Return the ensemble; validation tests choose the number of gradient steps, all tests train it.

        A test is computed in at most 64 blocks of eight steps; of more than 48 tests every m-th is used.

        Raises:
            FitError: no training was better than the untrained ensemble on the validation tests.
        """
        count = tests.command.shape[0]
        tests = tests.take(range(0, count, -(-count // MAX_TESTS)))
        samples = step_samples(tests)
        loss_mask, is_validation = np.asarray(tests.loss_mask), np.asarray(validation_mask(tests))
        signals, training, validation = (
            block_signals(tests, samples, mask)
            for mask in (loss_mask, loss_mask & ~is_validation, is_validation)
        )
        seed = int(jax.random.randint(context.key, (), 0, np.iinfo(np.int32).max))
        untrained = BlackBox.untrained(tests, signals, samples, seed)
        start = untrained.start(tests)
        travel = signals.travel / untrained.position_scale
        sections = Sections(
            inputs=untrained.inputs(tests, signals),
            start=start,
            position=jnp.asarray(travel, SINGLE) + start[None, :, None],
            increment_scale=jnp.asarray(untrained.increment_scale, SINGLE),
        )

        def trained() -> dict[str, np.ndarray]:
            networks, best_step = train_ensemble(
                untrained.networks,
                sections,
                jnp.asarray(training.mask, SINGLE),
                jnp.asarray(validation.mask, SINGLE),
                jnp.asarray(signals.mask, SINGLE),
                context.gradient_steps,
                context.progress,
            )
            return {**weights_of(networks), "best_step": np.asarray(best_step)}

        arrays = context.checkpoints.cached_arrays(
            "training", trained, {**weight_shapes(untrained.networks), "best_step": ()}
        )
        if not arrays["best_step"]:
            raise FitError(
                "the training never became better on the validation tests than displacement that stays; "
                "the baseline is left out of the comparison"
            )
        return eqx.tree_at(lambda model: model.networks, untrained, with_weights(untrained.networks, arrays))

    def skeleton(self, shapes: Sizes) -> BlackBox:
        """Return a model of the stored sizes, all arrays zero."""
        networks = IntegratingLstm(
            *(
                jnp.zeros(shapes[f"networks/{name}"], SINGLE)
                for name in ("weight_ih", "weight_hh", "bias", "head", "head_bias")
            )
        )
        scalings = (np.zeros(shapes.get(name, ())) for name in SCALINGS)
        return BlackBox(networks, *scalings, samples=np.zeros((), np.int64))


@eqx.filter_jit
def mean_positions(
    networks: IntegratingLstm, inputs: Array, start: Array, increment_scale: Array
) -> Float32[Array, "k t m"]:
    """Return the mean of the positions of all members, shape [K, T, M]."""
    members = eqx.filter_vmap(IntegratingLstm.simulate, in_axes=(eqx.if_array(0), None, None, None))
    return members(networks, inputs, start, increment_scale).mean(axis=0)
