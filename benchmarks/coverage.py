"""Do 95 % intervals hold the truth? Simulated campaigns of known plants, tests with coloured noise.

Twelve tests of 6 s a campaign: a random binary command behind a dead zone that three ramps found, a plant,
errors of a first-order Markov process (0.3 mm, 1 s) and white noise of 0.05 mm. Three studies: the form is
given and holds the plant; it is chosen automatically from forms that hold the plant; it is given and does not
hold the plant, where the value asked for is the best-fitting one of the form.
Prints a Markdown table of how often the interval holds the value, and of the verdicts.

    python benchmarks/coverage.py [CAMPAIGNS] [given] [chosen] [outside]
"""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter

from hitchid.bench.excitation import prbs, precompensated
from hitchid.estimation import MultiStart
from hitchid.identification.phase1 import Phase1, find_parameters, identify_benchmark
from hitchid.identification.selection import AutoStructure, choose_spec
from hitchid.logs.record import LIFTING, Record
from hitchid.model import Estimate, Interval
from hitchid.structures import Batch, ModelSpec, PhysicalModel, Scales, structure_named
from hitchid.uncertainty import DeadZoneError

TESTS, DURATION_S, STEP_S = 12, 6.0, 0.01
DEAD_ZONE_A, DEAD_ZONE_SPREAD_A = 0.38, 0.002
COLOURED_MM, COLOURED_S, WHITE_MM = 0.3, 1.0, 0.05
HIGHEST_A = 0.8
UNITS = {"x": "mm", "u": "A"}
CURVE_PARAMETERS = {"opening": 0.05, "exponent": 1.3, "saturation": 1.5}
SEARCH = MultiStart(starts=2)
MANY_TESTS = 480  # of the campaign whose fit is the best-fitting value
SCALES = Scales(*map(jnp.asarray, (HIGHEST_A, 0.0, 1.0)))


@dataclass(frozen=True)
class Plant:
    """A plant, and how its tests are run.

    Attributes:
        form: what is identified.
        truth: the parameters it was simulated with; infinite for a time constant that is not there.
        clock_s: shortest time a level of the command is held, s.
        simulated: form of the truth, where it is another than what is identified.
    """

    form: ModelSpec
    truth: Mapping[str, float]
    clock_s: float = 0.2
    simulated: ModelSpec | None = None

    def benchmark(self) -> PhysicalModel:
        """Return the truth."""
        form = self.simulated or self.form
        values = [self.truth[parameter.name] for parameter in form.parameters]
        return form.physical_model(jnp.asarray(values), SCALES)


PLANTS = {
    "second order": Plant(
        ModelSpec(structure_named("integrator-second-order")),
        {"gain": 40.0, "natural_frequency": 12.0, "damping_ratio": 0.7},
    ),
    "first order, dead time": Plant(
        ModelSpec(structure_named("integrator-first-order"), dead_time=True),
        {"gain": 30.0, "time_constant": 0.1, "dead_time": 0.03},
    ),
    "lag of 8 s": Plant(ModelSpec(structure_named("first-order-lag")), {"gain": 30.0, "time_constant": 8.0}),
    "first order, valve curve": Plant(
        ModelSpec(
            structure_named("integrator-first-order"), valve_curve=True, bounds={"opening": (-0.2, 0.2)}
        ),
        {"gain": 40.0, "time_constant": 0.1, **CURVE_PARAMETERS},
    ),
    "lag that is an integrator": Plant(
        ModelSpec(structure_named("first-order-lag")),
        {"gain": 30.0, "time_constant": np.inf},
        simulated=ModelSpec(structure_named("integrator")),
    ),
    "second order, too fast for a slow clock": Plant(
        ModelSpec(structure_named("integrator-second-order")),
        {"gain": 40.0, "natural_frequency": 150.0, "damping_ratio": 0.7},
        clock_s=1.0,
    ),
}

SECOND_ORDER = ModelSpec(structure_named("integrator-second-order"), dead_time=True)
CURVED = replace(SECOND_ORDER, valve_curve=True, bounds={"opening": (-0.1, 0.1)})
WITH_SPOOL = replace(CURVED, spool_dynamics=True)
LINEAR_VALUES = {"gain": 40.0, "natural_frequency": 12.0, "damping_ratio": 0.7, "dead_time": 0.04}
SPOOL_VALUES = {"hysteresis": 0.1, "spool_lag": 0.02}
# Truth of a parameter that the chosen form has and the plant has not.
NEUTRAL_TRUTH = {
    "dead_time": 0.0,
    "opening": 0.0,
    "exponent": 1.0,
    "saturation": np.inf,
    "hysteresis": 0.0,
    "spool_lag": 0.0,
    "position_slope": 0.0,
    "position_curve": 0.0,
}
CHOSEN_PLANTS = {
    "second order": PLANTS["second order"],
    "second order, dead time, valve curve": Plant(CURVED, {**LINEAR_VALUES, **CURVE_PARAMETERS}),
    "second order, dead time, valve curve, spool": Plant(
        WITH_SPOOL, {**LINEAR_VALUES, **CURVE_PARAMETERS, **SPOOL_VALUES}
    ),
}
OUTSIDE_PLANTS = {
    "second order for a plant with valve curve and spool": Plant(
        ModelSpec(structure_named("integrator-second-order")),
        {**LINEAR_VALUES, **CURVE_PARAMETERS, **SPOOL_VALUES},
        simulated=WITH_SPOOL,
    ),
    "first order, valve curve for a plant of second order with spool": Plant(
        PLANTS["first order, valve curve"].form,
        {**LINEAR_VALUES, **CURVE_PARAMETERS, **SPOOL_VALUES},
        simulated=WITH_SPOOL,
    ),
}


def campaign(plant: Plant, rng: np.random.Generator) -> tuple[list[Record], float, DeadZoneError]:
    """Return the tests of one campaign, the dead zone that ramps gave, and how well it is known."""
    records = [make_test(plant, rng, number) for number in range(TESTS)]
    ramps = DEAD_ZONE_A + DEAD_ZONE_SPREAD_A * rng.standard_normal(3)
    return records, float(ramps.mean()), DeadZoneError(float(ramps.std(ddof=1) / np.sqrt(3)), 3)


def make_test(plant: Plant, rng: np.random.Generator, number: int, speed: float = 1.0) -> Record:
    """Return one test of a campaign, with a factor on its speed; the first goes to the highest command."""
    effective = prbs(
        low=rng.uniform(0.03, 0.2),
        high=rng.uniform(0.4, 1.0) * HIGHEST_A if number else HIGHEST_A,
        clock_s=plant.clock_s,
        duration_s=DURATION_S,
        seed=int(rng.integers(2**31)),
    )
    return record_of(plant, precompensated(effective, DEAD_ZONE_A), rng, f"{number}", speed)


def record_of(
    plant: Plant, command: np.ndarray, rng: np.random.Generator, name: str, speed: float = 1.0
) -> Record:
    """Return what a plant answers to a command as logged, with its errors and a factor on its speed."""
    signals = {"displacement": np.zeros(command.size), "lifting_command": command}
    units = {"displacement": UNITS["x"], "lifting_command": UNITS["u"]}
    rest_batch = Batch.of([Record(name, STEP_S, signals, units)], LIFTING, dead_zone=DEAD_ZONE_A, sign=1)
    travel = np.asarray(plant.benchmark().travel(rest_batch))[0, : command.size]
    decay = np.exp(-STEP_S / COLOURED_S)
    innovations = COLOURED_MM * np.sqrt(1 - decay**2) * rng.standard_normal(command.size)
    innovations[0] = COLOURED_MM * rng.standard_normal()
    noise = lfilter([1.0], [1.0, -decay], innovations) + WHITE_MM * rng.standard_normal(command.size)
    return Record(name, STEP_S, {**signals, "displacement": speed * travel + noise}, units)


def identify_given(plant: Plant, seed: int) -> Phase1:
    """Identify the plant's form from one simulated campaign."""
    records, zone, error = campaign(plant, np.random.default_rng(seed))
    batch = Batch.of(records, LIFTING, dead_zone=zone, sign=1)
    return identify_benchmark(batch, plant.form, SEARCH, 0, units=UNITS, dead_zone=error)


def identify_chosen(plant: Plant, seed: int) -> tuple[Phase1, str]:
    """Choose a form for one simulated campaign automatically and identify it; returns what it has, too."""
    records, zone, error = campaign(plant, np.random.default_rng(seed))
    batch = Batch.of(records, LIFTING, dead_zone=zone, sign=1)
    auto_structure = AutoStructure(ModelSpec(structure_named("integrator-second-order")))
    phase1, _ = choose_spec(
        batch, auto_structure, SEARCH, 0, units=UNITS, opening_known=True, dead_zone=error
    )
    return phase1, ", ".join(parameter.name for parameter in phase1.fit.objective.spec.parameters)


def best_fitting(plant: Plant) -> dict[str, float]:
    """Return the best-fitting parameters of a form that does not hold the plant.

    They minimise the expectation of the objective over campaigns; here over one campaign of many tests.
    """
    rng = np.random.default_rng(0)
    records = [make_test(plant, rng, number % TESTS) for number in range(MANY_TESTS)]
    batch = Batch.of(records, LIFTING, dead_zone=DEAD_ZONE_A, sign=1)
    values = find_parameters(batch, plant.form, SEARCH, 0).values
    names = [parameter.name for parameter in plant.form.parameters]
    return dict(zip(names, values.tolist(), strict=True))


def study_given(campaigns: int) -> None:
    """The form is given and holds the plant: how often the intervals hold the truth."""
    for name, plant in PLANTS.items():
        results = [identify_given(plant, seed).parameter_estimates for seed in range(campaigns)]
        report(name, plant.truth, results)


def study_chosen(campaigns: int) -> None:
    """The form is chosen automatically from forms that hold the plant."""
    for name, plant in CHOSEN_PLANTS.items():
        results, chosen = [], Counter[str]()
        for seed in range(campaigns):
            phase1, form = identify_chosen(plant, seed)
            results.append(phase1.parameter_estimates)
            chosen[form] += 1
        report(name, {**NEUTRAL_TRUTH, **plant.truth}, results)
        for form, count in chosen.most_common():
            write_row(name, f"chosen: {form}", count)


def study_outside(campaigns: int) -> None:
    """The form is given and does not hold the plant: how often intervals hold the best-fitting value."""
    for name, plant in OUTSIDE_PLANTS.items():
        results = [identify_given(plant, seed).parameter_estimates for seed in range(campaigns)]
        report(name, best_fitting(plant), results)


STUDIES = {"given": study_given, "chosen": study_chosen, "outside": study_outside}


def report(name: str, truth: Mapping[str, float], campaigns: Sequence[Sequence[Estimate]]) -> None:
    """Print a row for each parameter, and one for all that are called determined together."""
    all_covered: list[bool] = []
    for parameter, value in truth.items():
        estimates = [e for campaign in campaigns for e in campaign if e.name == parameter]
        if not estimates:
            continue
        covered = np.array([_covers(estimate.interval, value) for estimate in estimates])
        determined = np.array([estimate.determined for estimate in estimates])
        bootstrap = [e.bootstrap is not None and _covers(e.bootstrap, value) for e in estimates]
        all_covered += covered[determined].tolist()
        write_row(
            name,
            parameter,
            len(estimates),
            *(percent(share) for share in (covered, bootstrap, determined, covered[determined])),
        )
    write_row(name, "all that is called determined", len(all_covered), "", "", "", percent(all_covered))


def percent(flags: Sequence[bool] | np.ndarray) -> str:
    """Return the share of true ones, in percent; a dash where there are none."""
    return f"{100 * np.mean(flags):.1f}" if len(flags) else "-"


def write_row(*cells: object) -> None:
    """Print one row of the table."""
    sys.stdout.write(f"| {' | '.join(map(str, cells))} |\n")
    sys.stdout.flush()


def main() -> None:
    """Run the studies that were asked for, or all."""
    jax.config.update("jax_enable_x64", True)
    campaigns = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    write_row(
        "plant",
        "parameter",
        "campaigns",
        "value in the interval / %",
        "in the bootstrap's / %",
        "called determined / %",
        "value in the interval of those / %",
    )
    sys.stdout.write(f"|{' --- |' * 7}\n")
    for study in sys.argv[2:] or STUDIES:
        STUDIES[study](campaigns)


def _covers(interval: Interval, truth: float) -> bool:
    lower, upper = interval
    return (lower is None or lower <= truth) and (upper is None or truth <= upper)


if __name__ == "__main__":
    main()
