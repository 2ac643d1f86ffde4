"""Proof of a position controller: closed loops on the virtual bench beside baselines and prediction."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from hitchid._support import checks
from hitchid._support.precision import double_precision
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent
from hitchid._support.records import short_repr
from hitchid.bench import Rig
from hitchid.bench.simulation import SAMPLE_S
from hitchid.control.closed_loop import (
    ClosedLoops,
    Plant,
    PositionController,
    measured_at_rest,
    run_closed_loops,
    run_plant_loops,
)
from hitchid.control.controller import HitchController
from hitchid.control.prediction import Band, band_of, drawn_hitches, run_on_model
from hitchid.control.scenarios import (
    Kind,
    Scenario,
    baselines,
    least_time_s,
    plant_scenarios,
    scenarios,
    step_name,
)
from hitchid.model import Hitch, Load

# Figures of a position controller: the worst of 95 % of its closed loops in each scenario.

SHARE = 0.95  # of the loops, whose worst figure is stated
FINAL_S = 1.0  # s at the end of a run over which the final error is averaged
ON_A = 1e-9  # A, above which a valve is on


@short_repr
class Figures(NamedTuple):
    """Figures of one controller in one scenario; the worst of 95 % of the loops.

    Attributes:
        iae: ∫ abs(target − displacement) dt, the mean of the loops.
        rmse: of the tracking.
        overshoot: beyond the end of a step; None without one.
        settling_s: until the displacement stays within the tolerance of a step; None without one.
        final_error: distance of the mean measured displacement of the last second to the target.
        valve_actions_per_10_s: how often a valve opens.
        both_valves_samples: samples of all loops with current in both valves.
        samples_until_closed: samples with current after the sensor was lost, the longest; None otherwise.
        diverged: loops with a displacement that is not finite.
    """

    iae: float
    rmse: float
    overshoot: float | None
    settling_s: float | None
    final_error: float
    valve_actions_per_10_s: float
    both_valves_samples: int
    samples_until_closed: int | None
    diverged: int

    @classmethod
    def of(cls, scenario: Scenario, loops: ClosedLoops) -> "Figures":
        """Return the figures of closed loops in a scenario."""
        errors = (loops.displacement - scenario.target)[:, scenario.begin :]
        final = loops.measured[:, -round(FINAL_S / SAMPLE_S) :] - scenario.target[-1]
        on = loops.commands > ON_A
        # Openings of either valve; a closing follows each.
        opened = np.sum(np.diff(on.astype(int), axis=1) > 0, axis=(1, 2))
        overshoot = None
        if scenario.amplitude:
            beyond = np.sign(scenario.amplitude) * errors
            overshoot = _worst(np.maximum(beyond.max(axis=1), 0.0))
        return cls(
            iae=float(np.mean(SAMPLE_S * np.abs(errors).sum(axis=1))),
            rmse=_worst(np.sqrt(np.mean(errors**2, axis=1))),
            overshoot=overshoot,
            settling_s=_settling_s(scenario, errors),
            final_error=_worst(np.abs(np.nanmean(final, axis=1))),
            valve_actions_per_10_s=_worst(10 * opened / (SAMPLE_S * scenario.target.size)),
            both_valves_samples=int(np.sum(np.all(on, axis=-1))),
            samples_until_closed=_samples_until_closed(scenario, on),
            diverged=int(np.sum(~np.isfinite(loops.displacement).all(axis=1))),
        )


def iae_ratios(
    figures: Mapping[str, Figures], baseline: Mapping[str, Figures], kinds: Mapping[str, Kind]
) -> dict[str, float]:
    """Return the ratio of the IAE to a baseline's: geometric means over the steps, ramps and sines.

    The kinds count alike in `all`, whatever their number and length: the IAE of a step of 100 mm, which at
    the largest current no controller can change, is fifty times that of a ramp.
    """
    ratios = {}
    for kind in (Kind.STEP, Kind.RAMP, Kind.SINE):
        # Geometric: half and twice the IAE of a rival cancel out.
        logs = [np.log(figures[name].iae / baseline[name].iae) for name, own in kinds.items() if own is kind]
        ratios[kind.value] = float(np.exp(np.mean(logs)))
    return {"all": float(np.exp(np.mean(np.log(list(ratios.values()))))), **ratios}


def _worst(values: Float[np.ndarray, " t"]) -> float:
    return float(np.quantile(values, SHARE))


def _settling_s(scenario: Scenario, errors: Float[np.ndarray, "t n"]) -> float | None:
    """Return the time after which no displacement is outside the tolerance; infinite at the end of a run."""
    if not scenario.amplitude:
        return None
    # Not "larger than": an error that is no number is outside.
    outside = ~(np.abs(errors) <= scenario.tolerance)
    last = errors.shape[1] - np.argmax(outside[:, ::-1], axis=1)
    settled = np.where(outside.any(axis=1), np.where(outside[:, -1], np.inf, last), 0)
    # The quantile is a time of the loops: between one of them and ∞ there is nothing to interpolate.
    ordered = np.sort(SAMPLE_S * settled)
    return float(ordered[int(np.ceil(SHARE * ordered.size)) - 1])


def _samples_until_closed(scenario: Scenario, on: Bool[np.ndarray, "t n 2"]) -> int | None:
    lost = np.asarray(scenario.surroundings.sensor_lost)
    if not lost.any():
        return None
    still_on = np.asarray(np.any(on[:, lost], axis=2))
    samples = still_on.shape[1] - np.argmax(still_on[:, ::-1], axis=1)
    return int(np.max(np.where(np.any(still_on, axis=1), samples, 0)))


DRAWS = 20  # closed loops of a scenario by default; chosen
LOAD_SPREAD = 0.1  # the implement's mass is drawn within ±10 %; chosen
BAND_DRAWS = 60  # runs on drawn models of a band; chosen
READINGS = 100  # of the sensor before a run, of which the band starts at the mean; chosen: one second
BAND_KINDS = (Kind.STEP, Kind.RAMP, Kind.SINE)
INSIDE_SHARE = 0.9  # of a run's samples that must be inside the band of 90 % for it to count as inside
TESTED, BASELINE = "controller", "SIMC PI"  # names among the controllers


@short_repr
@dataclass(frozen=True)
class Drive:
    """Closed loops of a controller and of the baselines in every scenario.

    Attributes:
        scenarios: name to scenario.
        loops: controller to scenario to signals.
        figures: controller to scenario to figures.
        bands: scenario to the band predicted from the identified model; empty without a model.
        least_times_s: step to the least time of the bench at the largest current, s; empty of another plant.
        unit, command_unit: of displacement and commands.
    """

    scenarios: Mapping[str, Scenario]
    loops: Mapping[str, Mapping[str, ClosedLoops]]
    figures: Mapping[str, Mapping[str, Figures]]
    bands: Mapping[str, Band]
    least_times_s: Mapping[str, float]
    unit: str = "mm"
    command_unit: str = "A"

    @property
    def draws(self) -> int:
        """Closed loops of a scenario."""
        return len(next(iter(self.loops[TESTED].values())).displacement)

    @property
    def iae_ratios(self) -> dict[str, float]:
        """Ratios of the IAE to that of SIMC PI without inverse; see `figures.iae_ratios`."""
        kinds = {name: scenario.kind for name, scenario in self.scenarios.items()}
        return iae_ratios(self.figures[TESTED], self.figures[BASELINE], kinds)

    @property
    def changed_ratios(self) -> dict[str, float]:
        """Scenario of changed load or oil to the ratio of its IAE to that of the same step without change."""
        own = self.figures[TESTED]
        return {
            name: own[name].iae / own[step_name(scenario.amplitude)].iae
            for name, scenario in self.scenarios.items()
            if scenario.kind in (Kind.LOAD_CHANGE, Kind.COLD_OIL)
        }

    @property
    def inside_band(self) -> dict[str, float]:
        """Scenario to the share of its loops that are inside the predicted band; see `INSIDE_SHARE`."""
        return {
            name: float(np.mean(band.contains(self.loops[TESTED][name].measured) >= INSIDE_SHARE))
            for name, band in self.bands.items()
        }

    @property
    def metrics(self) -> dict[str, object]:
        """All figures as content for JSON."""
        own = self.figures[TESTED]
        steps = {
            f"{scenario.amplitude:g}": {
                "overshoot": own[name].overshoot,
                "settling_s": _finite(own[name].settling_s),
                "t_min_s": _finite(self.least_times_s.get(name)),
                "final_error": own[name].final_error,
                "iae": own[name].iae,
            }
            for name, scenario in self.scenarios.items()
            if scenario.kind is Kind.STEP
        }
        by_kind = {scenario.kind: own[name] for name, scenario in self.scenarios.items()}
        lost = by_kind[Kind.SENSOR_LOST]
        ramps = [own[name].rmse for name, scenario in self.scenarios.items() if scenario.kind is Kind.RAMP]
        inside, band = self.inside_band, None
        if inside:
            band = {"inside": float(np.mean(list(inside.values()))), "scenarios": inside}
        ploughing = by_kind.get(Kind.PLOUGHING)
        return {
            "unit": self.unit,
            "draws": self.draws,
            "steps": steps,
            "hold": {
                "valve_actions_per_10_s": by_kind[Kind.HOLD].valve_actions_per_10_s,
                "rmse": by_kind[Kind.HOLD].rmse,
            },
            "both_valves_samples": sum(figures.both_valves_samples for figures in own.values()),
            "sine": {"rmse": by_kind[Kind.SINE].rmse},
            "ramps": {"rmse": max(ramps)},
            **({"ploughing": {"rmse": ploughing.rmse}} if ploughing is not None else {}),
            "changes": self.changed_ratios,
            "sensor_lost": {
                "samples_until_closed": lost.samples_until_closed,
                "final_error": lost.final_error,
            },
            "diverged": sum(figures.diverged for figures in own.values()),
            "band": band,
            "iae_ratio": self.iae_ratios["all"],
            "iae_ratios": self.iae_ratios,
            "iae": {
                controller: {name: own.iae for name, own in figures.items()}
                for controller, figures in self.figures.items()
            },
        }


@double_precision
def drive(
    controller: HitchController,
    rig: Rig | Plant,
    *,
    tested: PositionController | None = None,
    model: Hitch | None = None,
    load: Load | None = None,
    travel: tuple[float, float] | None = None,
    units: tuple[str, str] = ("mm", "A"),
    draws: int = DRAWS,
    seed: int = 0,
    progress: ProgressCallback = silent,
) -> Drive:
    """Drive a controller through all scenarios on the virtual bench, with drawn loads and noise.

    A plant from elsewhere, or the identified model itself, is driven through steps, ramps, a sine and holding
    within its travel, and loses its sensor once.

    Args:
        controller: tuned; the baselines and the largest currents are from its axes.
        rig: the bench, or a plant from elsewhere, such as `ModelPlant`.
        tested: another controller to be proved in its place.
        model: from which the band of each run is predicted before it; None for no bands.
        load: covariates of the runs that are predicted; their mean by default.
        travel: lowest and highest displacement of a plant from elsewhere.
        units: of displacement and commands.
        draws: closed loops of a scenario.
        seed: of loads and noise.
        progress: called with what is done.

    Raises:
        InputError: a number is out of range, a plant from elsewhere comes without its travel, or `tested`
            returns other than two currents.
    """
    checks.instance(controller, HitchController, "controller", "a controller as load_controller returns it")
    checks.integer(draws, "draws", minimum=1)
    checks.integer(seed, "seed")

    def slowest(middle: float) -> float:
        return min(float(axis.fastest(jnp.asarray(middle))) for axis in controller.axes)

    bands, times_s = {}, {}
    if isinstance(rig, Rig):
        todo, units = scenarios(rig, slowest(500 * float(rig.cylinder.stroke))), ("mm", "A")
        # Before the runs: a band that has seen them would be no prediction.
        bands = {} if model is None else _bands(controller, rig, model, load, todo, seed, progress)
        largest = np.array([axis.largest_command for axis in controller.axes])
        times_s = {own.name: least_time_s(rig, largest, own) for own in todo if own.kind is Kind.STEP}
    elif travel is None or not travel[0] < travel[1]:
        raise checks.input_error("travel", "lowest and highest displacement of the plant", travel)
    else:
        todo = plant_scenarios(*travel, slowest(0.5 * sum(travel)), units[0])
    factors = np.random.default_rng(seed).uniform(1 - LOAD_SPREAD, 1 + LOAD_SPREAD, draws)
    controllers = {TESTED: controller if tested is None else tested, **baselines(controller)}
    loops, figures = {}, {}
    for number, (name, driven) in enumerate(cast(dict[str, PositionController], controllers).items()):
        progress(ProgressUpdate(f"closed loops: {name}", 0.2 + 0.2 * number))
        loops[name] = {scenario.name: _run(driven, rig, scenario, factors, seed) for scenario in todo}
        figures[name] = {scenario.name: Figures.of(scenario, loops[name][scenario.name]) for scenario in todo}
    return Drive({scenario.name: scenario for scenario in todo}, loops, figures, bands, times_s, *units)


def travel_of(model: Hitch) -> tuple[float, float]:
    """Return the lowest and the highest displacement of the tests of a model."""
    ranges = [channel.operating_range.displacement for channel in model.channels.values()]
    # Of both directions together: tests that lift from below and lower from above need not overlap.
    return min(float(own.lowest) for own in ranges), max(float(own.highest) for own in ranges)


def _run(
    driven: PositionController,
    rig: Rig | Plant,
    scenario: Scenario,
    factors: Float[np.ndarray, " t"],
    seed: int,
) -> ClosedLoops:
    """Return a loop of a scenario for each factor on the implement's mass, which another plant has not."""
    target, start, around = scenario.target, scenario.start, scenario.surroundings
    if not isinstance(rig, Rig):
        count, lost = factors.size, around.sensor_lost
        return run_plant_loops(driven, rig, seed, target, start=start, loops=count, sensor_lost=lost)
    # The same key for all controllers: they are compared under equal noise and loads.
    key = jax.random.key(seed)
    return run_closed_loops(
        driven, rig, key, target, start_mm=start, implement_factors=factors, surroundings=around
    )


def _bands(
    controller: HitchController,
    rig: Rig,
    model: Hitch,
    load: Load | None,
    todo: list[Scenario],
    seed: int,
    progress: ProgressCallback,
) -> dict[str, Band]:
    hitches = drawn_hitches(controller, model, load, BAND_DRAWS, seed, load_spread=LOAD_SPREAD)
    if hitches is None:
        return {}
    progress(ProgressUpdate("prediction by the identified model", 0.05))
    bands = {}
    for scenario in todo:
        if scenario.kind in BAND_KINDS:
            key, start = jax.random.key(seed), scenario.start
            # The sensor's offset is known before a run, as on a bench that stands still for a second.
            measured = measured_at_rest(rig, key, start, READINGS)
            runs = run_on_model(
                controller, hitches, key, scenario.target, start=start, measured_start=measured
            )
            bands[scenario.name] = band_of(runs)
    return bands


def _finite(value: float | None) -> float | None:
    """Return a number for JSON; None for one that is not finite."""
    return value if value is not None and np.isfinite(value) else None
