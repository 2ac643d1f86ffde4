"""Covariates on the virtual bench: what they gain, what measured motion tells of them, what is kept in vain.

Run: python benchmarks/scheduling.py [rig ...], or python benchmarks/scheduling.py without-effect [campaigns]
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import hitchid
from hitchid._support.precision import parallel
from hitchid.bench.virtual_campaign import Conditions, write_campaign
from hitchid.identification import AutoStructure, MultiStart
from hitchid.identification.selection import choose_spec
from hitchid.logs.campaign import Campaign
from hitchid.logs.kinds import effective_command
from hitchid.logs.record import DIRECTIONS, LIFTING, Record
from hitchid.model import Hitch
from hitchid.model.inputs import covariates_of
from hitchid.structures import Batch, ModelSpec, Scales, structure_named

IMPLEMENTS_KG, OIL_C = tuple(np.linspace(450.0, 1300.0, 6)), tuple(np.linspace(5.0, 70.0, 5))
ALONE = ((450.0, 5.0), (960.0, 37.5), (1300.0, 70.0))  # kg, °C: conditions with a model of their own
TESTS, TESTS_ALONE = 2, 20  # tests of a direction in each condition, and for a model of one condition
AFTER_MOTION_S = (1.0, 2.0)  # of measured motion, from which the covariates are estimated
FAST = {"training": None, "rivals": None}
CAMPAIGNS, COVARIATES = 200, ("engine", "flow", "oil")


def show(*lines: str) -> None:
    """Write lines to standard output at once."""
    sys.stdout.write("".join(f"{line}\n" for line in lines))
    sys.stdout.flush()


def campaign(rig: str, conditions: Conditions, tests: int, seed: int) -> Campaign:
    """Return a campaign over operating conditions."""
    with tempfile.TemporaryDirectory() as folder:
        logs = Path(folder) / "logs"
        write_campaign(logs, rig, tests={"prbs": tests}, conditions=conditions, seed=seed)
        return hitchid.read(logs)


def without_covariates(given: Campaign) -> Campaign:
    """Return a campaign of the same tests in which no covariate was measured."""
    records = tuple(
        replace(
            record,
            signals={role: rows for role, rows in record.signals.items() if role not in given.covariates},
            units={role: unit for role, unit in record.units.items() if role not in given.covariates},
        )
        for record in given.records
    )
    return replace(given, records=records)


def free_run_errors(model: Hitch, tests: Campaign, direction: str) -> dict[str, float]:
    """Return test to free-run RMSE, mm."""
    return {
        record.name: float(np.sqrt(np.mean((model.simulate(record).displacement - record.displacement) ** 2)))
        for record in tests.of_kind(direction)
    }


def late_errors(
    model: Hitch, tests: Campaign, direction: str, after_s: float, *, estimated: bool = False
) -> dict[str, float]:
    """Return test to RMSE later than some time after motion begins, mm.

    The free run is that at the measured covariates. With `estimated` no covariate is measured; the
    displacement up to that time is, then the model runs free.
    """
    errors = {}
    for record in tests.of_kind(direction):
        beyond = effective_command(record.command(direction), model.dead_zones[direction])
        begin = int(np.flatnonzero(beyond)[0]) + round(after_s / record.step_s)
        predicted = (
            without_covariates_after(model, record, begin)
            if estimated
            else np.asarray(model.simulate(record))
        )
        errors[record.name] = float(np.sqrt(np.mean((predicted - record.displacement)[begin + 1 :] ** 2)))
    return errors


def without_covariates_after(model: Hitch, record: Record, begin: int) -> np.ndarray:
    """Return the prediction, mm, from displacements up to a sample, by a model that knows no covariate."""
    commands = np.array([record.command(name) for name in DIRECTIONS]).T
    nothing = dict.fromkeys(covariates_of(model.channels.values()))
    state, predicted = model.init_state(record.displacement[0], nothing), [record.displacement[0]]
    for row, measured in zip(commands[:-1], record.displacement[:-1], strict=True):
        state, displacement = model.step(state, row, measured if len(predicted) <= begin else None)
        predicted.append(float(displacement))
    return np.array(predicted)


def late_line(
    models: tuple[Hitch, Hitch], campaigns: tuple[Campaign, Campaign], direction: str, after_s: float
) -> str:
    """Return what a model gains after some motion, with its covariates measured and without.

    Args:
        models: with covariates and without.
        campaigns: the same unseen tests for each of them.
        direction: the direction.
        after_s: time of motion that is measured, s.
    """
    scheduled, unscheduled = models
    unseen, plain = campaigns
    with_load, without, estimated = (
        rms(late_errors(scheduled, unseen, direction, after_s)),
        rms(late_errors(unscheduled, plain, direction, after_s)),
        rms(late_errors(scheduled, plain, direction, after_s, estimated=True)),
    )
    regained = (without - estimated) / (without - with_load)
    return (
        f"  from {after_s:g} s after motion: with covariates {with_load:.3f} mm, without {without:.3f} mm; "
        f"estimated from that motion {estimated:.3f} mm: {100 * regained:.0f} % of the gain"
    )


def rms(errors: dict[str, float], part: str = "") -> float:
    """Return the root mean square over tests whose name contains a part, mm."""
    return float(np.sqrt(np.mean([error**2 for name, error in errors.items() if part in name])))


def report(rig: str) -> None:
    """Print the figures of one rig."""
    grid = Conditions(IMPLEMENTS_KG, OIL_C)
    training, unseen = (campaign(rig, grid, TESTS, seed) for seed in (1, 2))
    plain = without_covariates(unseen)
    scheduled = hitchid.identify(training, **FAST)
    unscheduled = hitchid.identify(without_covariates(training), **FAST).model
    for direction in DIRECTIONS:
        (chosen,) = (each for each in scheduled.channels[direction].candidates if each.chosen)
        with_load = free_run_errors(scheduled.model, unseen, direction)
        without = free_run_errors(unscheduled, plain, direction)
        gain = 1 - rms(with_load) / rms(without)
        show(
            *(
                f"  {each.held_out_rmse:.2f} mm held out: {each.name}"
                for each in scheduled.channels[direction].candidates
            )
        )
        show(
            f"{rig}, {direction}: {chosen.name}; {' '.join(chosen.spec.covariate_names)}",
            f"  free run, {len(with_load)} unseen tests: with covariates {rms(with_load):.3f} mm, without "
            f"{rms(without):.3f} mm: {100 * gain:.0f} % less",
        )
        for after_s in AFTER_MOTION_S:
            show(late_line((scheduled.model, unscheduled), (unseen, plain), direction, after_s))
    for number, (mass, oil) in enumerate(ALONE):
        own = campaign(rig, Conditions((mass,), (oil,)), TESTS_ALONE, 10 + number)
        model = hitchid.identify(without_covariates(own), **FAST).model
        name = f"{mass:g}kg-{oil:g}C"
        here = replace(unseen, records=tuple(r for r in unseen.records if r.name.endswith(name)))
        for direction in DIRECTIONS:
            alone = rms(free_run_errors(model, without_covariates(here), direction))
            shared = rms(free_run_errors(scheduled.model, here, direction))
            show(
                f"  {direction} at {name}: own model {alone:.3f} mm, with covariates {shared:.3f} mm, "
                f"{shared / alone:.2f} times"
            )


def kept_in_vain(seed: int) -> bool:
    """Return whether a covariate without effect was kept, in one campaign of a known plant."""
    rng = np.random.default_rng(seed)
    spec = ModelSpec(structure_named("integrator-second-order"))
    scales = Scales(*map(np.asarray, (1.0, 90.0, 40.0)))
    tests, samples = 12, 250
    commands = np.repeat(rng.uniform(0.2, 1.0, (tests, samples // 25)), 25, axis=1)
    commands *= np.linspace(0.5, 1.0, tests)[:, None]
    commands[:, :5] = 0.0

    def batch(travel: np.ndarray) -> Batch:
        records = [
            hitchid.Record(
                f"{number:02d}",
                0.01,
                {
                    "displacement": 80.0 + rows,
                    "lifting_command": command,
                    **{name: np.full(samples, value) for name, value in zip(COVARIATES, loads, strict=True)},
                },
                {"displacement": "mm", "lifting_command": "A", **dict.fromkeys(COVARIATES, "1")},
            )
            for number, (rows, command, loads) in enumerate(zip(travel, commands, covariates, strict=True))
        ]
        return Batch.of(records, LIFTING, dead_zone=0.0, sign=1, covariates=COVARIATES)

    covariates = rng.standard_normal((tests, len(COVARIATES)))
    still = batch(np.zeros((tests, samples)))
    values = np.array([20.0, 15.0, 0.6])
    travel = np.asarray(spec.physical_model(values, scales).travel(still))[:, :samples]
    loads = np.exp(0.015 * rng.standard_normal((tests, 1)))  # nobody measures it
    noise = 0.05 * rng.standard_normal(travel.shape)
    auto = AutoStructure(spec, COVARIATES)
    _, candidates = choose_spec(
        batch(loads * travel + noise), auto, MultiStart(evaluations=60), seed, units={"x": "mm", "u": "A"}
    )
    return any(each.chosen and each.spec.covariates for each in candidates)


def without_effect(campaigns: int) -> None:
    """Print in how many campaigns covariates without effect are kept."""
    kept = parallel(kept_in_vain, range(campaigns))
    total = sum(kept.values())
    show(f"three covariates without effect: one is kept in {total} of {campaigns} campaigns")


if __name__ == "__main__":
    if sys.argv[1:2] == ["without-effect"]:
        without_effect(int(sys.argv[2]) if len(sys.argv) > 2 else CAMPAIGNS)
    else:
        for name in sys.argv[1:] or ("nominal", "heavy-cold", "light-warm-worn"):
            report(name)
