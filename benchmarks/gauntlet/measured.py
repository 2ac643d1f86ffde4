"""The measured sets of `HITCHID_DATA` by default identify, each with the figures it has bars for."""

import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

import hitchid
from hitchid.identification import Identification
from hitchid.logs.record import COMMAND, DISPLACEMENT, IDLE, LIFTING
from hitchid.structures import ModelSpec, structure_named

from .bars import holds, read_bars
from .judge import exercise_model
from .long_job import write_long_job
from .machine_speed import seconds_of_work, slowness
from .outcome import REFUSED, Outcome, run_guarded

DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[3] / "shared" / "data"))
PAUSE_S = 60.0
PREDICTED_EVERY_S = 0.01  # chosen: at 1 kHz neighbouring predictions a second ahead are alike
ATTEMPTS = 3
TIMES = ("physics model / s", "identify / s")
MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
# Half of the last digit that excavator-boom states of angle, duty and pressure.
ROUNDING = {DISPLACEMENT: 0.5e-4, "command": 0.5e-4, "covariate": 0.5e-3}
UNSEEN = {"field-excavator": ("field-05", "field-06"), "electro-hydraulic-actuator": ("load3-",)}
EMPS = """[signals]
time = { column = "t", unit = "s" }
lifting_command = { column = "vir", unit = "V" }
displacement = { column = "qm", unit = "m" }

[split]
test = ["*PULSES"]
"""


def judge_set(name: str) -> Outcome:
    """Identify, use and judge one measured set."""
    return _fail_on_refusal(run_guarded(Outcome(name), lambda outcome: SETS[name](outcome, name)))


def judge_speed(name: str) -> Outcome:
    """Time one default identification, its programs compiled before."""

    def judge(outcome: Outcome) -> None:
        campaign = hitchid.read(DATA / name)
        _time_identification(outcome, campaign)

    return _fail_on_refusal(run_guarded(Outcome(f"{name}, warm"), judge))


def _fail_on_refusal(outcome: Outcome) -> Outcome:
    """Return an outcome that must not be a refusal: each of these sets has a model."""
    if outcome.result == REFUSED:
        outcome.failures.append(f"{outcome.stage}: refused: {outcome.message}")
    return outcome


def _time_identification(
    outcome: Outcome, campaign: hitchid.Campaign, prepare: Callable[[], object] = lambda: None
) -> Identification:
    """Identify until all times are within their bars, three times at most: the shortest of each counts.

    What else the machine does lengthens times, often for minutes, and shortens none. Times are those at the
    reference machine's speed.

    Args:
        outcome: gets them.
        campaign: what is identified from.
        prepare: called before each attempt.
    """
    bars = {name: bar for name, bar in read_bars()[outcome.name].items() if name in TIMES}
    for attempt in range(1, ATTEMPTS + 1):
        prepare()
        seconds_before, started, seconds = seconds_of_work(), time.perf_counter(), {}

        def on_physics(_: Identification, started: float = started, seconds: dict = seconds) -> str:
            seconds[TIMES[0]] = time.perf_counter() - started
            return ""

        identification = hitchid.identify(campaign, on_physics=on_physics)
        seconds[TIMES[1]] = time.perf_counter() - started
        factor = slowness(seconds_before, seconds_of_work())
        outcome.figures |= {"attempts": attempt, "times longer than on the reference machine": factor}
        for figure, value in seconds.items():
            outcome.figures[figure] = min(value / factor, outcome.figures.get(figure, np.inf))
        if all(holds(bar, outcome.figures[figure]) for figure, bar in bars.items()):
            break
    return identification


def _identified(outcome: Outcome, campaign: hitchid.Campaign, **settings) -> tuple[hitchid.Hitch, dict]:
    with outcome.timed("identify"):
        identification = hitchid.identify(campaign, **settings)
    return _used(outcome, campaign, identification)


def _used(
    outcome: Outcome, campaign: hitchid.Campaign, identification: Identification
) -> tuple[hitchid.Hitch, dict]:
    if outcome.name in SETS_WITH_RIVALS:
        with outcome.timed("rivals"):
            model = hitchid.train_rivals(identification.model, campaign)
        identification = replace(identification, model=model)
    with tempfile.TemporaryDirectory() as folder:
        model, metrics = exercise_model(outcome, identification, campaign, Path(folder))
    for direction, uncertainty in model.uncertainty.items():
        for estimate in uncertainty.benchmark.parameters:
            outcome.verdicts.append(f"{direction} {estimate.name}: {estimate.verdict}")
    return model, metrics


def _read(outcome: Outcome, name: str) -> hitchid.Campaign:
    with outcome.timed("read"):
        return hitchid.read(DATA / name)


def rig(outcome: Outcome, name: str) -> None:
    """Free run, one step, bands and cycles of the simulated hitch bench, and whether it stands undriven."""
    campaign = _read(outcome, name)
    model, metrics = _identified(outcome, campaign)
    for direction, channel in metrics["channels"].items():
        covered = channel["bands"]["free_run"]["covered"], channel["bands"]["horizons"]["covered"][0]
        ahead = dict(zip(channel["horizons"]["steps"], channel["horizons"]["greybox"], strict=True))
        outcome.figures |= {
            f"{direction}: one step rmse": channel["greybox"]["one_step"]["rmse"],
            f"{direction}: 10 steps rmse": ahead[10],
            f"{direction}: 100 steps rmse": ahead[100],
            f"{direction}: free run in its band": covered[0],
            f"{direction}: one step in its band": covered[1],
            f"{direction}: moved in a pause": _pause_drift(model, campaign.held_out(direction)[0]),
        }
    cycles = metrics["cycles"]
    outcome.figures |= {
        "cycles: 10 steps rmse": cycles["horizons"]["greybox"][cycles["horizons"]["steps"].index(10)],
        "cycles: largest jump": cycles["max_jump"],
    }


def _pause_drift(model: hitchid.Hitch, record: hitchid.Record) -> float:
    """Return how far a model moves in a minute without commands, a second after a test's middle."""
    middle, pause, settling = len(record) // 2, round(PAUSE_S / record.step_s), round(1.0 / record.step_s)

    def hold_constant(role: str, samples: np.ndarray) -> np.ndarray:
        rest = 0.0 if role in COMMAND.values() else samples[middle]
        return np.concatenate([samples[:middle], np.full(pause, rest), samples[middle:]])

    signals = {role: hold_constant(role, samples) for role, samples in record.signals.items()}
    displacement = model.simulate(replace(record, signals=signals)).displacement
    return float(np.ptp(displacement[middle + settling : middle + pause]))


def boom(outcome: Outcome, name: str) -> None:
    """R² of unseen duties, each stroke by itself."""
    _, metrics = _identified(outcome, _read(outcome, name))
    for direction, channel in metrics["channels"].items():
        fits = [test["free_run"]["r2"] for test in channel["per_test"].values()]
        outcome.figures |= {
            f"{direction}: mean R²": float(np.mean(fits)),
            f"{direction}: worst R²": float(min(fits)),
        }


def hanging_load(outcome: Outcome, name: str) -> None:
    """Free run beside the paper's transfer function."""
    _, metrics = _identified(outcome, _read(outcome, name))
    for direction, channel in metrics["channels"].items():
        baseline_rmse = channel["baselines"].get("transfer_function", channel["benchmark"])["free_run"][
            "rmse"
        ]
        outcome.figures[f"{direction}: share of the paper's"] = (
            channel["greybox"]["free_run"]["rmse"] / baseline_rmse
        )


def whole_logs(outcome: Outcome, name: str) -> None:
    """Free run over whole unseen logs, and one second ahead beside persistence."""
    campaign = _read(outcome, name)
    model, _ = _identified(outcome, campaign)
    free_run_errors, ahead_errors, persistence_errors = [], [], []
    for record in campaign.records:
        if record.kind == IDLE or not record.name.startswith(UNSEEN[name]):
            continue
        factor, second = MILLIMETRES[record.unit], max(1, round(1.0 / record.step_s))
        stride = max(1, round(PREDICTED_EVERY_S / record.step_s))
        measured = factor * record.displacement
        free_run_errors.append(factor * model.simulate(record).displacement - measured)
        ahead = factor * model.predictions(record, (second,), stride=stride)[0]
        ahead_errors.append((ahead - measured)[second::stride])
        persistence_errors.append((measured[:-second] - measured[second:])[::stride])
    outcome.figures["whole logs: free run / mm"] = _rms(free_run_errors)
    outcome.figures["whole logs: 1 s ahead / persistence"] = _rms(ahead_errors) / _rms(persistence_errors)
    outcome.figures["whole logs: largest error / mm"] = float(
        max(np.abs(error).max() for error in free_run_errors)
    )


def dspace(outcome: Outcome, name: str) -> None:
    """ControlDesk's files beside the same records as excavator-boom holds them."""
    raw = {record.name: record for record in _read(outcome, name).records}
    clean = {record.name: record for record in hitchid.read(DATA / "excavator-boom").records}
    largest_difference = 0.0
    for key, record in raw.items():
        other = clean[key]
        if len(record) != len(other):
            outcome.failures.append(f"{key}: {len(record)} samples, excavator-boom has {len(other)}")
            continue
        for role, samples in record.signals.items():
            same = other.signals[role] if role in other.signals else other.signals["head_pressure"]
            kind = "command" if role in COMMAND.values() else role
            rounding = ROUNDING.get(kind, ROUNDING["covariate"])
            largest_difference = max(largest_difference, float(np.max(np.abs(samples - same))) / rounding)
    outcome.figures["largest difference / rounding"] = largest_difference


def emps(outcome: Outcome, name: str) -> None:
    """RMSE of the official test without its first 20 samples."""
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / "emps.toml"
        settings.write_text(EMPS, encoding="utf-8")
        with outcome.timed("read"):
            campaign = hitchid.read(DATA / name, signals=settings)
    model, _ = _identified(outcome, campaign, structure=_structure("inertia-with-friction"))
    outcome.figures["RMSE / mm"] = 1000 * _official_rmse(model, campaign, 20)


def tanks(outcome: Outcome, name: str) -> None:
    """RMSE of the official test without its first 50 samples."""
    table = np.genfromtxt(DATA / name / "dataBenchmark.csv", delimiter=",", names=True)
    units = {DISPLACEMENT: "V", COMMAND[LIFTING]: "V"}
    records = [
        hitchid.Record(key, 4.0, {COMMAND[LIFTING]: table[f"u{key}"], DISPLACEMENT: table[f"y{key}"]}, units)
        for key in ("Est", "Val")
    ]
    campaign = hitchid.Campaign.of(records, test_patterns=["Val"], kinds={"*": LIFTING})
    model, _ = _identified(outcome, campaign, structure=_structure("cascaded-tanks"))
    outcome.figures["RMSE / V"] = _official_rmse(model, campaign, 50)


def long_job(outcome: Outcome, name: str) -> None:
    """Identify 14 logs made from the field's, with nothing compiled before; use the model on the last two."""
    with tempfile.TemporaryDirectory() as folder, outcome.timed("read"):
        write_long_job(DATA / SOURCES[name], Path(folder) / "job")
        campaign = hitchid.read(Path(folder) / "job")
    outcome.description = f"{len(campaign.records)} logs, {sum(map(len, campaign.records))} samples"

    def forget_programs() -> None:
        jax.clear_caches()
        jax.config.update("jax_enable_compilation_cache", False)
        compilation_cache.reset_cache()

    with outcome.timed("identify"):
        identification = _time_identification(outcome, campaign, forget_programs)
    _used(outcome, campaign, identification)


def _structure(name: str) -> dict[str, ModelSpec]:
    return {LIFTING: ModelSpec(structure_named(name))}


def _official_rmse(model: hitchid.Hitch, campaign: hitchid.Campaign, skipped: int) -> float:
    (record,) = campaign.held_out(LIFTING)
    return _rms([(model.simulate(record).displacement - record.displacement)[skipped:]])


def _rms(errors: list[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


SETS: dict[str, Callable[[Outcome, str], None]] = {
    # The longest first, so that all cores end together.
    "rig-a": rig,
    "excavator-boom": boom,
    "hanging-load": hanging_load,
    "field-excavator": whole_logs,
    "electro-hydraulic-actuator": whole_logs,
    "dspace-raw": dspace,
    "emps": emps,
    "cascaded-tanks": tanks,
    "long-job": long_job,
}
SOURCES = {"long-job": "field-excavator"}
WARM_SETS = ("rig-a",)  # timed once more, alone, with their programs compiled
ALONE = "long-job"  # timed as well, with nothing compiled: last of its process, and with no other beside it
SETS_WITH_RIVALS = ("rig-a", "excavator-boom", "electro-hydraulic-actuator")


def missing(name: str) -> bool:
    """Tell whether a set's folder is not there."""
    return not (DATA / SOURCES.get(name, name)).is_dir()
