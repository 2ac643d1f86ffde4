"""Filters are found again from simulated tests; tests that tell nothing give a finite filter."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hitchid._support.precision import double_precision
from hitchid.errors import FitError
from hitchid.identification.load_filter_fit import MAX_LOAD_SCATTER, fit_load_filter
from hitchid.logs.record import LIFTING
from hitchid.structures import Batch

STEP_S, SAMPLES, TESTS = 0.01, 400, 24
NOISE_MM, LOAD, TRANSIENT_MM, TIME_S = 0.05, 0.03, 0.08, 0.15
# Standard errors: of a scatter from T tests 1/√(2 T); of the noise from T N samples. A transient forgets
# itself over two times τ, which leaves T N Ts/(2 τ) independent values of it.
LOAD_ERROR = 1 / np.sqrt(2 * TESTS)
TRANSIENT_ERROR = 1 / np.sqrt(TESTS * SAMPLES * STEP_S / TIME_S)


def simulated(make_record, rng, *, load=LOAD, transient=TRANSIENT_MM, noise=NOISE_MM):
    """Return tests as a batch, and what their benchmark simulates, shape [T, N], mm."""
    runs, records = [], []
    kept = np.exp(-STEP_S / TIME_S)
    for _ in range(TESTS):
        speed = np.repeat(rng.uniform(0, 40, SAMPLES // 40), 40)
        travel = np.concatenate([[0.0], np.cumsum(STEP_S * speed)[:-1]])
        error = load * rng.standard_normal() * travel
        state = 0.0
        for sample in range(1, SAMPLES):
            state = kept * state + np.sqrt(1 - kept**2) * transient * rng.standard_normal()
            error[sample] += state
        runs.append(50 + travel)
        records.append(make_record(50 + travel + error + noise * rng.standard_normal(SAMPLES), speed / 40))
    batch = Batch.of(records, LIFTING, dead_zone=0.0, sign=1, initial=[50.0] * TESTS)
    padding = batch.displacement.shape[1] - SAMPLES
    return batch, np.pad(np.array(runs), ((0, 0), (0, padding)), mode="edge")


@double_precision
def test_a_filter_is_found_again_and_a_refit_stays_there(make_record):
    batch, runs = simulated(make_record, np.random.default_rng(3))
    load_filter = fit_load_filter(batch, runs)
    assert float(load_filter.load_scatter) == pytest.approx(LOAD, rel=3 * LOAD_ERROR)
    assert float(load_filter.transient_scatter) == pytest.approx(TRANSIENT_MM, rel=3 * TRANSIENT_ERROR)
    assert float(load_filter.transient_time) == pytest.approx(TIME_S, rel=6 * TRANSIENT_ERROR)
    assert float(load_filter.noise) == pytest.approx(NOISE_MM, rel=0.1)
    assert float(load_filter.load_length) > runs.max() - runs.min()  # the load of a test stays
    again = fit_load_filter(batch, runs, load_filter)
    for name in ("noise", "load_scatter", "transient_scatter", "transient_time"):
        assert float(getattr(again, name)) == pytest.approx(float(getattr(load_filter, name)), rel=0.02)


@double_precision
def test_the_load_at_most_doubles_the_speed(make_record):
    # Loads of ± 200 %: a benchmark that is wrong.
    batch, runs = simulated(make_record, np.random.default_rng(5), load=2.0)
    assert float(fit_load_filter(batch, runs).load_scatter) == pytest.approx(MAX_LOAD_SCATTER)


@double_precision
@pytest.mark.parametrize("case", ["the benchmark is exact", "nothing moves", "one short test"])
def test_tests_that_tell_nothing_give_a_finite_filter(make_record, case):
    rng = np.random.default_rng(4)
    exact = case == "the benchmark is exact"
    parts = {"load": 0.0, "transient": 0.0, "noise": 0.0} if exact else {}
    batch, runs = simulated(make_record, rng, **parts)
    if case == "nothing moves":
        runs = np.full_like(runs, 50.0)
        batch = batch.with_dead_zone(10.0)
    if case == "one short test":
        batch = batch.take([0]).masked(jnp.arange(batch.command.shape[1])[None] < 4)
        runs = runs[:1]
    load_filter = fit_load_filter(batch, runs)
    values = np.array([float(value) for value in jax.tree.leaves(load_filter)])
    assert np.all(np.isfinite(values))
    assert np.all(values > 0)


@double_precision
@pytest.mark.parametrize("fold", [0, 3])
def test_of_many_tests_those_that_count_are_used(make_record, fold):
    batch, runs = simulated(make_record, np.random.default_rng(6))
    copies = 8  # 192 tests, of which every fourth counts: every fourth is also how they are thinned out
    many = batch.take([*range(TESTS)] * copies)
    counts = np.arange(copies * TESTS) % 4 == fold
    load_filter = fit_load_filter(many.masked(jnp.asarray(counts)[:, None]), np.tile(runs, (copies, 1)))
    # Six of the 24 loads.
    assert float(load_filter.load_scatter) == pytest.approx(LOAD, rel=3 / np.sqrt(2 * TESTS / 4))


@double_precision
def test_a_benchmark_that_diverges_has_no_filter(make_record):
    batch, runs = simulated(make_record, np.random.default_rng(5))
    runs[3, 200:] = np.inf
    with pytest.raises(FitError, match="not finite"):
        fit_load_filter(batch, runs)
