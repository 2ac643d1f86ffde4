"""Does the plant need two modes? One shared linear model against one a direction."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from scipy.special import fdtrc

from hitchid._support.metrics import proven_better
from hitchid.estimation import Misfit
from hitchid.estimation.search import polish
from hitchid.identification.preparation import Prepared
from hitchid.model import TwoModes
from hitchid.structures import Batch, Form, structure_named

FORM = Form(structure_named("integrator-first-order"), dead_time=True)
STARTS = ((0.5, 0.4, 0.5), (0.5, 0.2, 0.5), (0.5, 0.7, 0.2))
FOLDS = 4
STEPS, REFITTED = 40, 10
SAMPLES = 1024
SIGNIFICANT = 0.01


def compare_modes(prepared: Mapping[str, Prepared]) -> TwoModes | None:
    """Compare one linear model for both directions with one for each, in free run.

    K/(s (τ s + 1)) with a dead time, from effective command to travel. Every fourth test of each direction is
    held out in turn. The statistic is that of nested models, with tests in place of samples, for samples of
    one test err alike:

        F = ((S₁ − S₂)/p) / (S₂/(T − 2 p)),  S = Σ over tests of the mean square error

    with S₁ shared and S₂ of two models, p parameters a model, and T tests. Two modes are needed where
    held-out tests prove two models better and F is significant at 1 %.

    Args:
        prepared: mode to its tests.

    Returns:
        The comparison; None where there is one direction only, or too few tests.
    """
    if len(prepared) < 2:
        return None
    batch, mode = _together([each.everything.thinned(SAMPLES) for each in prepared.values()])
    parameters = len(FORM.parameters)
    freedom = mode.size - 2 * parameters
    if freedom < 1 or min(np.bincount(mode)) < FOLDS:
        return None
    misfit = Misfit.of(batch, FORM)
    groups = {"shared": [np.ones(mode.size, bool)], "two": [mode == each for each in np.unique(mode)]}
    fold = np.concatenate([np.arange(np.sum(mode == each)) % FOLDS for each in np.unique(mode)])
    errors: dict[str, np.ndarray] = {}
    held_out: dict[str, np.ndarray] = {}
    for name, members in groups.items():
        errors[name], held_out[name] = np.zeros(mode.size), np.zeros(mode.size)
        for tests in members:
            best = min(
                (_fitted(misfit, tests, np.array(start), STEPS) for start in STARTS),
                key=lambda position: float(np.sum(misfit.by_test(position)[tests] ** 2)),
            )
            errors[name][tests] = misfit.by_test(best)[tests]
            for number in range(FOLDS):
                held = tests & (fold == number)
                refitted = _fitted(misfit, tests & ~held, best, REFITTED)
                held_out[name][held] = misfit.by_test(refitted)[held]
    shared, two = (float(np.sum(errors[name] ** 2)) for name in ("shared", "two"))
    statistic = max(shared - two, 0.0) / parameters / (two / freedom)
    chance = float(fdtrc(parameters, freedom, statistic))
    return TwoModes(
        needed=proven_better(held_out["two"], held_out["shared"]) and chance < SIGNIFICANT,
        shared_rmse=float(np.sqrt(np.mean(held_out["shared"] ** 2))),
        two_rmse=float(np.sqrt(np.mean(held_out["two"] ** 2))),
        f_statistic=statistic,
        p_value=chance,
        tests=int(mode.size),
    )


def _together(batches: list[Batch]) -> tuple[Batch, np.ndarray]:
    """Return the tests of both directions as travel from zero, and the place of each one's direction."""
    width = max(batch.command.shape[1] for batch in batches)

    def joined(name: str) -> jnp.ndarray:
        rows = [np.asarray(getattr(batch, name)) for batch in batches]
        return jnp.asarray(np.concatenate([np.pad(r, ((0, 0), (0, width - r.shape[1]))) for r in rows]))

    mode = np.repeat(np.arange(len(batches)), [batch.command.shape[0] for batch in batches])
    none = jnp.zeros(mode.size)
    return Batch(
        command=joined("command"),
        logged=joined("logged"),
        dead_zone=jnp.concatenate([batch.dead_zone for batch in batches]),
        displacement=joined("travel"),
        valid=joined("valid"),
        counted=joined("counted"),
        initial=none,
        load=none,
        step_s=batches[0].step_s,
        direction=1,
    ), mode


def _fitted(misfit: Misfit, tests: np.ndarray, start: np.ndarray, limit: int) -> np.ndarray:
    """Return the least squares over some tests; shapes stay, so that one program does for all."""
    counted = jnp.asarray(np.broadcast_to(tests[:, None], misfit.batch.counted.shape))
    problem = misfit.over(misfit.batch.counting(counted)).problem()
    return polish(problem, start, limit=limit).position
