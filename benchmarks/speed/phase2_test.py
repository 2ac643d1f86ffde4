"""Phase 2 to one validation error, beside an LSTM on sliding windows in PyTorch."""

import time
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from timings import OURS
from windows_torch import BATCH, EPOCHS, LEARNING_RATE, TORCH, MeasuredTests, fastest_threads, train

from hitchid.estimation import Whale
from hitchid.identification import AdamConfig, CompensatorConfig
from hitchid.identification.identify import PAPER_SPECS
from hitchid.identification.phase1 import find_parameters
from hitchid.identification.phase2 import train_compensator
from hitchid.identification.preparation import prepare
from hitchid.logs import read
from hitchid.logs.record import DIRECTIONS
from hitchid.model.channel import predict_errors
from hitchid.model.load_filter import LoadFilter
from hitchid.networks.error_compensator import Compensator, Sample, measured_features
from hitchid.structures import Batch

SEEDS = (0, 1, 2)
TOLERANCE = 1.01
ModelledTests = tuple[Batch, jax.Array]
LossHistory = list[tuple[float, float]]


@pytest.fixture(scope="module", params=DIRECTIONS)
def tests(request, rig_a) -> tuple[str, ModelledTests, ModelledTests]:
    """Return the direction, and its training and validation tests with what the benchmark gives for them."""
    direction = request.param
    prepared = prepare(read(rig_a), direction, None)
    fit = find_parameters(prepared.all_tests, PAPER_SPECS[direction], Whale(), 0)
    benchmark = fit.objective.spec.physical_model(jnp.asarray(fit.values), fit.objective.scales)

    def with_benchmark(batch: Batch) -> ModelledTests:
        return batch, batch.to_displacement(benchmark.travel(batch))

    return direction, with_benchmark(prepared.training), with_benchmark(prepared.validation)


def as_peer(tests_and_benchmark: ModelledTests) -> MeasuredTests:
    """Return tests as the peer has them, without padding."""
    batch, benchmark = tests_and_benchmark
    longest = int(batch.loss_mask.sum(axis=1).max())
    arrays = (np.asarray(array)[:, :longest] for array in (batch.command, benchmark, batch.displacement))
    return MeasuredTests(*arrays, batch.step_s)


def rmse_mm(predicted: np.ndarray, validation: MeasuredTests) -> float:
    """Return the error of predicted errors, mm: of every sample of the validation tests but their first."""
    return float(np.sqrt(np.mean((predicted - validation.error[:, 1:]) ** 2)))


def our_loss_history(
    training: ModelledTests, validation: ModelledTests, seed: int, settings: CompensatorConfig
) -> LossHistory:
    """Return seconds since the start and validation error, mm, after each of our epochs."""
    losses: LossHistory = []
    started = time.perf_counter()

    def on_epoch(epoch: int, training_loss: float, validation_loss: float) -> None:
        losses.append((time.perf_counter() - started, validation_loss))

    compensator, _ = train_compensator(
        training, validation, LoadFilter.none(), settings, jax.random.key(seed), on_epoch
    )
    course = [
        (elapsed_s, validation_loss * float(compensator.error_step)) for elapsed_s, validation_loss in losses
    ]
    # What training tells of each epoch is what the predictions of the best one give: one measure for both.
    np.testing.assert_allclose(predicted_mm(compensator, validation), min(e for _, e in course), rtol=1e-3)
    return course


def predicted_mm(compensator: Compensator, validation: ModelledTests) -> float:
    """Return the error of the kept compensator's predictions over the validation tests."""
    batch, benchmark = validation
    time_s = jnp.broadcast_to(batch.step_s * jnp.arange(benchmark.shape[1]), benchmark.shape)
    sample = Sample(time_s, batch.command, benchmark, batch.displacement)
    trust = jnp.ones_like(benchmark)
    errors = predict_errors(LoadFilter.none(), compensator, sample, trust, (1,), batch.step_s)[0]
    peer = as_peer(validation)
    return rmse_mm(np.asarray(errors)[:, 1 : peer.command.shape[1]], peer)


def peer_loss_history(
    training: MeasuredTests, validation: MeasuredTests, seed: int, epochs: int, threads: int
) -> LossHistory:
    """Return seconds since the start and validation error, mm, after each of the peer's epochs."""
    history = train(training, validation, seed, epochs, threads)
    return [(elapsed_s, rmse_mm(predicted, validation)) for elapsed_s, predicted in history]


def reached_s(course: LossHistory, level_mm: float) -> float:
    """Return the seconds until the error first is no larger than a level."""
    return next(elapsed_s for elapsed_s, error in course if error <= level_mm)


def test_features_agree(tests):
    """The peer's ten features are ours."""
    _, training, _ = tests
    batch, benchmark = training
    peer = as_peer(training)
    time_s = jnp.broadcast_to(batch.step_s * jnp.arange(benchmark.shape[1]), benchmark.shape)
    rows = Sample(*(array.T for array in (time_s, batch.command, benchmark, batch.displacement)))
    _, features = measured_features(rows, batch.step_s)
    ours = np.swapaxes(np.asarray(features), 0, 1)[:, : peer.command.shape[1]]
    np.testing.assert_allclose(peer.features(), ours, rtol=1e-9, atol=1e-9)


def test_training(tally, tests, pace):
    """Seconds until both reach the worse of all best validation errors, but for a percent."""
    direction, training, validation = tests
    settings = CompensatorConfig(adam=AdamConfig(epochs=3)) if pace.quick else CompensatorConfig()
    seeds: Sequence[int] = SEEDS[:1] if pace.quick else SEEDS
    epochs = 2 if pace.quick else EPOCHS
    our_loss_history(training, validation, seeds[0], settings)  # compiles
    peers = as_peer(training), as_peer(validation)
    threads = fastest_threads(peers[0])
    courses: dict[str, list[LossHistory]] = {OURS: [], TORCH: []}
    for seed in seeds:
        courses[OURS].append(our_loss_history(training, validation, seed, settings))
        courses[TORCH].append(peer_loss_history(*peers, seed, epochs, threads))
    best = {
        by: [min(error for _, error in course) for course in histories] for by, histories in courses.items()
    }
    level = TOLERANCE * max(max(errors) for errors in best.values())
    times = {by: [reached_s(course, level) for course in histories] for by, histories in courses.items()}
    best_errors = ", ".join(f"{by} {np.median(errors):.4f} mm" for by, errors in best.items())
    tally.note(
        f"{direction}, trained to a validation error of {level:.4f} mm",
        times,
        f"best of whole trainings, median: {best_errors}; the peer in batches of {BATCH}, Adam at "
        f"{LEARNING_RATE:g}, {threads} of two threads, whichever trains sooner",
    )
    longest = {by: [course[-1][0] for course in histories] for by, histories in courses.items()}
    tally.note(f"{direction}, trained until no longer better", longest, "each with its own early stopping")
