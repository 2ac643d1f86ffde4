"""Phase 2 to one validation error, beside an LSTM on sliding windows in PyTorch."""

import time
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from timings import OURS
from windows_torch import BATCH, EPOCHS, LEARNING_RATE, TORCH, Measured, fastest_threads, train

from hitchid.data.record import MODES
from hitchid.estimation import Whale
from hitchid.identification import Descent, Training
from hitchid.identification.identify import PAPER_FORMS
from hitchid.identification.phase1 import find_parameters
from hitchid.identification.phase2 import train_compensator
from hitchid.identification.preparation import prepare
from hitchid.networks.error_compensator import Compensator, Sample, measured_features, predicted_errors
from hitchid.readers import read
from hitchid.structures import Batch

SEEDS = (0, 1, 2)
ALMOST = 1.01
Known = tuple[Batch, jax.Array]
Course = list[tuple[float, float]]


@pytest.fixture(scope="module", params=MODES)
def tests(request, rig_a) -> tuple[str, Known, Known]:
    """Return the direction, and its training and validation tests with what the benchmark gives for them."""
    mode = request.param
    prepared = prepare(read(rig_a), mode, None)
    fit = find_parameters(prepared.everything, PAPER_FORMS[mode], Whale(), 0)
    benchmark = fit.misfit.form.benchmark(jnp.asarray(fit.values), fit.misfit.scales)

    def known(batch: Batch) -> Known:
        return batch, batch.displaced(benchmark.travel(batch))

    return mode, known(prepared.training), known(prepared.validation)


def as_peer(known: Known) -> Measured:
    """Return tests as the peer has them, without padding."""
    batch, benchmark = known
    longest = int(batch.counted.sum(axis=1).max())
    arrays = (np.asarray(each)[:, :longest] for each in (batch.command, benchmark, batch.displacement))
    return Measured(*arrays, batch.step_s)


def rmse_mm(predicted: np.ndarray, validation: Measured) -> float:
    """Return the error of predicted errors, mm: of every sample of the validation tests but their first."""
    return float(np.sqrt(np.mean((predicted - validation.error[:, 1:]) ** 2)))


def our_course(training: Known, validation: Known, seed: int, settings: Training) -> Course:
    """Return seconds since the start and validation error, mm, after each of our epochs."""
    losses: Course = []
    begun = time.perf_counter()

    def heard(epoch: int, trained: float, held: float) -> None:
        losses.append((time.perf_counter() - begun, held))

    found, _ = train_compensator(training, validation, settings, jax.random.key(seed), heard)
    course = [(spent, held * float(found.error_step)) for spent, held in losses]
    # What training tells of each epoch is what the predictions of the best one give: one measure for both.
    np.testing.assert_allclose(predicted_mm(found, validation), min(e for _, e in course), rtol=1e-3)
    return course


def predicted_mm(found: Compensator, validation: Known) -> float:
    """Return the error of the kept compensator's predictions over the validation tests."""
    batch, benchmark = validation
    time_s = jnp.broadcast_to(batch.step_s * jnp.arange(benchmark.shape[1]), benchmark.shape)
    known = Sample(time_s, batch.command, benchmark, batch.displacement)
    errors = predicted_errors(found, known, jnp.ones_like(benchmark), (1,), batch.step_s)[0]
    peer = as_peer(validation)
    return rmse_mm(np.asarray(errors)[:, 1 : peer.command.shape[1]], peer)


def their_course(training: Measured, validation: Measured, seed: int, epochs: int, threads: int) -> Course:
    """Return seconds since the start and validation error, mm, after each of the peer's epochs."""
    told = train(training, validation, seed, epochs, threads)
    return [(spent, rmse_mm(predicted, validation)) for spent, predicted in told]


def reached_s(course: Course, level_mm: float) -> float:
    """Return the seconds until the error first is no larger than a level."""
    return next(spent for spent, error in course if error <= level_mm)


def test_both_hear_the_same(tests):
    """The peer's ten features are ours."""
    _, training, _ = tests
    batch, benchmark = training
    peer = as_peer(training)
    time_s = jnp.broadcast_to(batch.step_s * jnp.arange(benchmark.shape[1]), benchmark.shape)
    rows = Sample(*(each.T for each in (time_s, batch.command, benchmark, batch.displacement)))
    _, features = measured_features(rows, batch.step_s)
    ours = np.swapaxes(np.asarray(features), 0, 1)[:, : peer.command.shape[1]]
    np.testing.assert_allclose(peer.features(), ours, rtol=1e-9, atol=1e-9)


def test_training(tally, tests, pace):
    """Seconds until both reach the worse of all best validation errors, but for a percent."""
    mode, training, validation = tests
    settings = Training(descent=Descent(epochs=3)) if pace.quick else Training()
    seeds: Sequence[int] = SEEDS[:1] if pace.quick else SEEDS
    epochs = 2 if pace.quick else EPOCHS
    our_course(training, validation, seeds[0], settings)  # compiles
    peers = as_peer(training), as_peer(validation)
    threads = fastest_threads(peers[0])
    courses: dict[str, list[Course]] = {OURS: [], TORCH: []}
    for seed in seeds:
        courses[OURS].append(our_course(training, validation, seed, settings))
        courses[TORCH].append(their_course(*peers, seed, epochs, threads))
    best = {by: [min(error for _, error in course) for course in each] for by, each in courses.items()}
    level = ALMOST * max(max(each) for each in best.values())
    times = {by: [reached_s(course, level) for course in each] for by, each in courses.items()}
    ends = ", ".join(f"{by} {np.median(each):.4f} mm" for by, each in best.items())
    tally.note(
        f"{mode}, trained to a validation error of {level:.4f} mm",
        times,
        f"best of whole trainings, median: {ends}; the peer in batches of {BATCH}, Adam at "
        f"{LEARNING_RATE:g}, {threads} of two threads, whichever trains sooner",
    )
    longest = {by: [course[-1][0] for course in each] for by, each in courses.items()}
    tally.note(f"{mode}, trained until no longer better", longest, "each with its own early stopping")
