"""Is the NARX rival a straw man? The package's own beside sysidentpy's on the same tests, in free run.

Both see travel and effective command of the same identification tests and choose lag and number of terms by
the free run of the same validation tests. sysidentpy (FROLS, polynomials of degree 2) fits coefficients one
step ahead; the package's refines them by free runs, with load and initial displacement as further inputs.
Prints a Markdown table of RMSE on unseen tests.

    python -m benchmarks.narx_library [SET ...]
"""

import sys
import warnings
from collections.abc import Iterator

import numpy as np
from sysidentpy.basis_function import Polynomial
from sysidentpy.model_structure_selection import FROLS

import hitchid
from hitchid.baselines.narx import LAGS, TERMS
from hitchid.structures import Batch, split_validation

from .free_run import SETS

DEFAULT_SETS = ("rig-a", "nominal")
Test = tuple[np.ndarray, np.ndarray]


def scaled_tests(batch: Batch, command_scale: float, travel_scale: float, lag: int) -> Iterator[Test]:
    """Yield command and travel of each test, shape [N], after a rest of the largest lag."""
    for command, travel, mask in zip(
        np.asarray(batch.command), np.asarray(batch.travel), np.asarray(batch.loss_mask), strict=True
    ):
        used = slice(0, int(np.flatnonzero(mask)[-1]) + 1)
        yield np.pad(command[used] / command_scale, (lag, 0)), np.pad(travel[used] / travel_scale, (lag, 0))


def library_narx(tests: list[Test], lag: int, terms: int) -> FROLS:
    """Return sysidentpy's NARX of all tests, one after another."""
    model = FROLS(
        n_terms=terms, order_selection=False, xlag=lag, ylag=lag, basis_function=Polynomial(degree=2)
    )
    command, travel = (np.concatenate(signals)[:, None] for signals in zip(*tests, strict=True))
    return model.fit(X=command, y=travel)


def free_run_rmse(model: FROLS, tests: list[Test], lag: int) -> float:
    """Return the RMSE of free runs from rest; infinite for a model that diverges."""
    errors = []
    for command, travel in tests:
        with np.errstate(all="ignore"):
            simulated = model.predict(X=command[:, None], y=travel[:lag, None])[:, 0]
        errors.append((simulated - travel)[lag:])
    rmse = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    return rmse if np.isfinite(rmse) else np.inf


def library_rmse(identification: Batch, unseen: Batch) -> float:
    """Return the RMSE on unseen tests of the NARX that sysidentpy finds, in the displacement's unit."""
    command_scale, travel_scale = (
        float(np.abs(np.asarray(signal)).max()) for signal in (identification.command, identification.travel)
    )
    training, validation = split_validation(identification)[:2]

    def tests_of(batch: Batch, lag: int) -> list[Test]:
        return list(scaled_tests(batch, command_scale, travel_scale, lag))

    errors = {
        (lag, terms): free_run_rmse(
            library_narx(tests_of(training, lag), lag, terms), tests_of(validation, lag), lag
        )
        for lag in LAGS
        for terms in TERMS
        if terms <= (2 * lag + 1) * (lag + 1)
    }
    lag, terms = min(errors, key=lambda sizes: errors[sizes])
    chosen = library_narx(tests_of(identification, lag), lag, terms)
    return travel_scale * free_run_rmse(chosen, tests_of(unseen, lag), lag)


def main() -> None:
    """Print the table, set by set."""
    warnings.simplefilter("ignore")
    say = sys.stdout.write
    say("| data | direction | sysidentpy | NARX of the package |\n| --- | --- | ---: | ---: |\n")
    for name in sys.argv[1:] or DEFAULT_SETS:
        campaign = SETS[name].campaign()
        model = hitchid.identify(campaign, rivals=True).model
        for direction, accuracy in hitchid.validate(model, campaign).accuracy.items():
            if direction not in model.channels:
                continue
            channel = model.channels[direction]
            identification, unseen = (
                channel.batch(tests)
                for tests in (campaign.identification(direction), campaign.held_out(direction))
            )
            own = accuracy.free_run("narx").rmse
            say(f"| {name} | {direction} | {library_rmse(identification, unseen):.3g} | {own:.3g} |\n")


if __name__ == "__main__":
    main()
