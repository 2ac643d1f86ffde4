"""Phase 1 of the lifting tests as hitchid does it, and the tests as its peer reads them."""

from dataclasses import fields
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from hitchid.estimation import Objective, SearchProblem, Whale, search_problem
from hitchid.estimation.whale import WhaleConfig
from hitchid.identification.identify import PAPER_SPECS
from hitchid.logs.record import LIFTING
from hitchid.structures import Batch

FORM = PAPER_SPECS[LIFTING]
ON_HOST = ("step_s", "direction")


def objective_of(batch: Batch) -> Objective:
    """Return the misfit of the paper's lifting benchmark over tests."""
    return Objective.of(batch, FORM)


def search(batch: Batch, seed: int, whales: int, iterations: int) -> float:
    """Return the best J found, everything that a search needs made from the tests."""
    return run_whale_search(search_problem(objective_of(batch)), seed, whales, iterations)


def search_by_simulation(batch: Batch, seed: int, whales: int, iterations: int) -> float:
    """Return the best J found where every evaluation simulates every test."""
    return run_whale_search(objective_of(batch).problem(), seed, whales, iterations)


def run_whale_search(problem: SearchProblem, seed: int, whales: int, iterations: int) -> float:
    """Return the best J that the whales find."""
    return Whale(WhaleConfig(population=whales, iterations=iterations)).minimise(problem, seed).best_fitness


def save(batch: Batch, path: Path) -> None:
    """Write tests for a process of its own, hitchid's or its peer's."""
    arrays = {field.name: np.asarray(getattr(batch, field.name)) for field in fields(batch)}
    bounds = objective_of(batch).bounds
    limits = np.stack([np.asarray(bounds.lower), np.asarray(bounds.upper)])
    np.savez(path, **arrays, travel=np.asarray(batch.travel), bounds=limits)


def load_batch(path: Path) -> Batch:
    """Read tests that `save` wrote."""
    with np.load(path) as archive:
        arrays = {f.name: jnp.asarray(archive[f.name]) for f in fields(Batch) if f.name not in ON_HOST}
        return Batch(**arrays, step_s=float(archive["step_s"]), sign=int(archive["direction"]))


def many_tests(batch: Batch, times: int, seed: int) -> Batch:
    """Return every test so many times over, each faster or slower and with other noise."""
    rng = np.random.default_rng(seed)
    counts = {f.name: np.asarray(getattr(batch, f.name)) for f in fields(batch) if f.name not in ON_HOST}
    repeated = {name: np.repeat(array, times, axis=0) for name, array in counts.items()}
    travel = repeated["displacement"] - repeated["initial"][:, None]
    travel *= rng.uniform(0.9, 1.1, (len(travel), 1))
    travel += 0.05 * rng.standard_normal(travel.shape)
    repeated["displacement"] = np.where(repeated["valid"], repeated["initial"][:, None] + travel, 0.0)
    arrays = {name: jnp.asarray(array) for name, array in repeated.items()}
    return Batch(**arrays, step_s=batch.step_s, sign=batch.sign)
