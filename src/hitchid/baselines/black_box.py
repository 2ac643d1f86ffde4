"""Black-box LSTM from command, load and its own displacement to speed, an ensemble trained on free runs."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Float, Float32, PyTree

from hitchid.baselines.baseline import Baseline, FitContext, FittedBaseline, Sizes
from hitchid.baselines.linear import MAX_STEP_SAMPLES, covariate_scaling, covariates_of
from hitchid.errors import FitError
from hitchid.estimation.training import EpochCallback, optimiser, weight_shapes, weights_of, with_weights
from hitchid.structures import Batch, validation_mask

# LSTM with its own position as an input, whose output are increments of it, in single precision.

SINGLE = jnp.float32  # type of all weights, states and inputs


class IntegratingLstm(eqx.Module):
    """LSTM in a loop with an integrator.

    At each block k: (h, c) = LSTM(inputs(k), x, h, c), then M increments σ (W h + b), added to x one by one.

    An ensemble has a leading axis over its members in each array.

    Attributes:
        weight_ih: from inputs to gates i, f, g, o, shape [I, 4 H].
        weight_hh: from the last output h and the position x to gates, shape [H + 1, 4 H].
        bias: of the gates, shape [4 H].
        head: from h to increments, shape [H, M].
        head_bias: of the increments, shape [M].
    """

    weight_ih: Float32[Array, "*e i g"]
    weight_hh: Float32[Array, "*e h1 g"]
    bias: Float32[Array, "*e g"]
    head: Float32[Array, "*e h m"]
    head_bias: Float32[Array, "*e m"]

    @classmethod
    def init(cls, rng: np.random.Generator, inputs: int, hidden: int, increments: int) -> "IntegratingLstm":
        """Return a network with gate weights uniform in ±1/√H and increments of zero: it stands still."""
        bound = 1 / np.sqrt(hidden)

        def random_weights(*shape: int) -> Array:
            return jnp.asarray(rng.uniform(-bound, bound, shape), SINGLE)

        return cls(
            random_weights(inputs, 4 * hidden),
            random_weights(hidden + 1, 4 * hidden),
            random_weights(4 * hidden),
            jnp.zeros((hidden, increments), SINGLE),
            jnp.zeros(increments, SINGLE),
        )

    def simulate(
        self, inputs: Float32[Array, "k b i"], start: Float32[Array, " b"], scale: Float32[Array, ""]
    ) -> Float32[Array, "k b m"]:
        """Return positions after each increment.

        Args:
            inputs: of K blocks of B tests, shape [K, B, I].
            start: position before the first block, shape [B].
            scale: factor on the increments, shape [].
        """
        head, head_bias = scale * self.head, scale * self.head_bias
        input_terms = inputs @ self.weight_ih + self.bias

        def advance(state: tuple[Array, Array, Array], terms: Array) -> tuple[tuple, Array]:
            h, c, position = state
            # σ(x) = ½ + ½ tanh(x/2): one function for all gates; the factor ½ is left to the weights.
            gates = jnp.tanh(terms + jnp.concatenate([h, position[:, None]], axis=1) @ self.weight_hh)
            i, f, g, o = jnp.split(gates, 4, axis=1)
            c = 0.5 * ((1 + f) * c + (1 + i) * g)
            h = 0.5 * (1 + o) * jnp.tanh(c)
            positions = position[:, None] + jnp.cumsum(h @ head + head_bias, axis=1)
            return (h, c, positions[:, -1]), positions

        zeros = jnp.zeros((inputs.shape[1], self.head.shape[0]), SINGLE)
        return jax.lax.scan(advance, (zeros, zeros, start), input_terms)[1]


# Training of an ensemble on free runs: full batch, all members in one compiled program.

# Gradient steps between two looks at the validation tests, before the training may stop, and without a
# better validation error after which it stops; chosen.
STEPS_PER_LOOK, FEWEST_STEPS, PATIENCE_STEPS = 50, 1500, 500
LEARNING_RATE = 1e-2  # of Adam at the start; chosen
CHOOSING_MEMBERS = 2  # members that choose the number of steps for all; chosen, it bounds the time
# Blocks over which errors of increments count beside the error of the position. Errors of a free run add up:
# they grow as those of a random walk, and increments show where they come from.
INCREMENT_BLOCKS = (2, 8)


class Sections(NamedTuple):
    """Free runs of B tests in K blocks of M steps, scaled; positions are measured at the end of each step."""

    inputs: Float32[Array, "k b i"]
    start: Float32[Array, " b"]
    position: Float32[Array, "k b m"]
    increment_scale: Float32[Array, ""]


def train_ensemble(
    untrained: IntegratingLstm,
    sections: Sections,
    training: Float32[Array, "k b m"],
    validation: Float32[Array, "k b m"],
    everything: Float32[Array, "k b m"],
    steps: int,
    progress: EpochCallback | None = None,
) -> tuple[IntegratingLstm, int]:
    """Choose the number of gradient steps on validation tests, then train on all tests for as many.

    Arrays have a leading axis over the members; errors weigh as given for choice and final training.

    Returns:
        The ensemble, and the number of steps it was trained for: 0 where no training improved it.
    """
    networks = jax.tree.map(lambda array: array[:CHOOSING_MEMBERS], untrained)
    best_step, best_error = 0, float(_mean_error(networks, sections, validation))
    state = _initial_state(networks, steps)
    for step in range(STEPS_PER_LOOK, steps + 1, STEPS_PER_LOOK):
        networks, state = _advance(networks, state, sections, training, steps)
        error = float(_mean_error(networks, sections, validation))
        if progress is not None:
            progress(step, float(_mean_error(networks, sections, training)), error)
        if error < best_error:
            best_step, best_error = step, error
        elif step >= FEWEST_STEPS and step - best_step >= PATIENCE_STEPS:
            break
    networks, state = untrained, _initial_state(untrained, steps)
    for _ in range(0, best_step, STEPS_PER_LOOK):
        networks, state = _advance(networks, state, sections, everything, steps)
    return networks, best_step


@eqx.filter_jit
def _mean_error(networks: IntegratingLstm, sections: Sections, weight: Array) -> Array:
    """Return the root mean square error of the members' mean."""
    positions = mean_positions(networks, sections.inputs, sections.start, sections.increment_scale)
    return jnp.sqrt(_mean_square(positions - sections.position, weight))


@partial(jax.jit, static_argnums=1)
def _initial_state(networks: PyTree, steps: int) -> PyTree:
    return jax.vmap(optimiser(LEARNING_RATE, steps).init)(networks)


@partial(jax.jit, static_argnums=4)
def _advance(
    networks: PyTree, state: PyTree, sections: Sections, weight: Array, steps: int
) -> tuple[PyTree, PyTree]:
    """Return networks and optimiser states after the gradient steps up to the next look."""
    adam = optimiser(LEARNING_RATE, steps)
    travel = sections.position - sections.start[:, None]
    scale = jnp.maximum(_mean_square(travel, weight), jnp.finfo(travel.dtype).tiny)

    def loss(network: IntegratingLstm) -> Array:
        positions = network.simulate(sections.inputs, sections.start, sections.increment_scale)
        return _loss(positions - sections.position, weight) / scale

    def step(carry: tuple[PyTree, PyTree], _: None) -> tuple[tuple[PyTree, PyTree], None]:
        network, state = carry
        change, state = adam.update(jax.grad(loss)(network), state, network)
        return (optax.apply_updates(network, change), state), None

    def advance(network: PyTree, state: PyTree) -> tuple[PyTree, PyTree]:
        return jax.lax.scan(step, (network, state), None, length=STEPS_PER_LOOK)[0]

    return jax.vmap(advance)(networks, state)


def _loss(errors: Array, weight: Array) -> Array:
    """Return the mean square of the errors of position and, as of a random walk, of increments."""
    blocks = errors.shape[0]
    total = _mean_square(errors, weight)
    for lag in INCREMENT_BLOCKS:
        if 2 * lag < blocks:
            both = weight[lag:] * weight[:-lag]
            total += blocks / (2 * lag) * _mean_square(errors[lag:] - errors[:-lag], both)
    return total


def _mean_square(errors: Array, weight: Array) -> Array:
    return jnp.sum(weight * errors**2) / jnp.maximum(jnp.sum(weight), 1.0)


# Signals of tests in blocks of several steps, the clock of the black box.

MAX_BLOCKS, STEPS = 64, 8  # blocks of the longest test, steps in a block; chosen: they bound the time


class BlockSignals(NamedTuple):
    """Signals of T tests in K blocks of M steps.

    Means of the command as logged and of the effective one, shape [K, T, M, 2]; travel at the end of each
    step and which of those errors are taken over, shape [K, T, M].
    """

    commands: np.ndarray
    travel: np.ndarray
    mask: np.ndarray


def step_samples(batch: Batch) -> int:
    """Return the samples of one step, so that the longest test has at most 64 blocks of eight steps."""
    longest = int(np.asarray(batch.valid).sum(axis=1).max())
    return -(-longest // (MAX_BLOCKS * STEPS))


def block_signals(batch: Batch, samples: int, mask: np.ndarray) -> BlockSignals:
    """Return the signals of tests in blocks of eight steps of so many samples each."""
    blocks = -(-int(np.asarray(batch.valid).sum(axis=1).max()) // (samples * STEPS))
    width = blocks * STEPS * samples

    def in_blocks(rows: np.ndarray) -> np.ndarray:
        return rows.reshape(rows.shape[0], blocks, STEPS, *rows.shape[2:]).swapaxes(0, 1)

    def fitted_to_width(rows: np.ndarray) -> np.ndarray:
        return np.pad(rows, ((0, 0), (0, max(0, width + 1 - rows.shape[1]))))[:, : width + 1]

    def means(rows: np.ndarray) -> np.ndarray:
        return fitted_to_width(rows)[:, :width].reshape(len(rows), -1, samples).mean(axis=2)

    commands = (np.asarray(batch.raw_command), np.asarray(batch.command))
    ends = slice(samples, None, samples)
    return BlockSignals(
        in_blocks(np.stack([means(command) for command in commands], axis=-1)),
        in_blocks(fitted_to_width(np.asarray(batch.travel))[:, ends]),
        in_blocks(fitted_to_width(np.asarray(mask))[:, ends]),
    )


def travel_at_samples(travel: np.ndarray, samples: int, count: int) -> np.ndarray:
    """Return travel at `count` samples, shape [T, N], linear between the ends of steps, shape [K, T, M]."""
    rows = np.moveaxis(travel, 1, 0).reshape(travel.shape[1], -1)
    ends = samples * np.arange(rows.shape[1] + 1)
    return np.stack([np.interp(np.arange(count), ends, [0.0, *row]) for row in rows])


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

    def check(self, covariates: int) -> None:
        """Check members, covariates, scales and steps; see `FittedBaseline.check`."""
        if len(self.networks.bias) < 1 or len(self.load_centre) != covariates:
            raise ValueError(
                f"got {len(self.networks.bias)} members for {len(self.load_centre)} covariates, expected at "
                f"least one for {covariates}"
            )
        scales = [self.command_scale, *self.load_scale, self.position_scale, self.increment_scale]
        if min(scales) <= 0 or not 1 <= self.samples <= MAX_STEP_SAMPLES:
            raise ValueError(
                f"got {min(scales):g} as smallest scale and steps of {self.samples} samples, expected more "
                f"than 0 and 1 to {MAX_STEP_SAMPLES}"
            )

    @classmethod
    def untrained(cls, batch: Batch, signals: BlockSignals, samples: int, seed: int) -> "BlackBox":
        """Return an ensemble that stands still, scaled to tests."""
        rng = np.random.default_rng(seed)
        inputs = 2 * STEPS + covariates_of(batch).shape[1]
        members = [IntegratingLstm.init(rng, inputs, HIDDEN, STEPS) for _ in range(MEMBERS)]
        position = batch.sign * np.asarray(batch.initial)
        scale = np.abs(signals.travel[signals.mask]).max(initial=0.0) or 1.0
        changes = np.diff(signals.travel, axis=2)[signals.mask[:, :, 1:]]
        increment = (np.abs(changes).mean() if changes.size else 0.0) / scale or 1.0
        command_scale = np.abs(batch.raw_command).max() or 1.0
        numbers = (command_scale, *covariate_scaling(batch), position.mean(), scale, increment, samples)
        networks = jax.tree.map(lambda *arrays: jnp.stack(arrays), *members)
        return cls(networks, *map(np.asarray, numbers))

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
            "training", trained, {**weight_shapes(untrained.networks), "best_step": int}
        )
        if not arrays["best_step"]:
            raise FitError(
                "the training never became better on the validation tests than displacement that stays; "
                "the baseline is left out of the comparison"
            )
        return eqx.tree_at(lambda model: model.networks, untrained, with_weights(untrained.networks, arrays))

    def skeleton(self, shapes: Sizes) -> BlackBox:
        """Return a model of the stored sizes, all arrays zero."""
        (members, gates), (loads,) = shapes["networks/bias"], shapes["load_centre"]
        rows = {
            "weight_ih": (2 * STEPS + loads, gates),
            "weight_hh": (gates // 4 + 1, gates),
            "bias": (gates,),
            "head": (gates // 4, STEPS),
            "head_bias": (STEPS,),
        }
        for name, shape in rows.items():  # before memory is allocated
            if shapes[f"networks/{name}"] != (members, *shape) or gates < 4:
                raise ValueError(f"{name}: got {shapes[f'networks/{name}']}, expected {(members, *shape)}")
        networks = IntegratingLstm(*(jnp.zeros((members, *shape), SINGLE) for shape in rows.values()))
        scalings = (np.zeros(loads if name.startswith("load_") else ()) for name in SCALINGS)
        return BlackBox(networks, *scalings, samples=np.zeros((), np.int64))


@eqx.filter_jit
def mean_positions(
    networks: IntegratingLstm, inputs: Array, start: Array, increment_scale: Array
) -> Float32[Array, "k t m"]:
    """Return the mean of the positions of all members, shape [K, T, M]."""
    members = eqx.filter_vmap(IntegratingLstm.simulate, in_axes=(eqx.if_array(0), None, None, None))
    return members(networks, inputs, start, increment_scale).mean(axis=0)
