"""Test campaign on the virtual bench: static tests, then dynamic tests within its limits."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hitchid._support import checks
from hitchid._support.files import write_folder
from hitchid._support.precision import parallel
from hitchid.bench import excitation
from hitchid.bench.excitation import (
    RAMP_TRAVEL_M,
    StaticResult,
    binary_command,
    cycle_commands,
    evaluate_ramps,
    two_channel_command,
)
from hitchid.bench.measurement import measure
from hitchid.bench.parameter_files import load_rig
from hitchid.bench.plant import Rig, rig_limits
from hitchid.bench.simulation import simulate
from hitchid.bench.valves import TANK_PRESSURE_PA, Values
from hitchid.errors import InputError
from hitchid.logs import COMMAND, DIRECTIONS, DISPLACEMENT, LIFTING, RAMP, Record, write_table

# Operating conditions of a campaign on the virtual bench: implement, oil temperature, a second consumer.

LITRES_PER_MIN = 1e-3 / 60  # m³/s
PRESSURE_NOISE_BAR, OIL_NOISE_C, FLOW_NOISE_L_MIN = 0.1, 0.3, 0.1  # white noise of their sensors, rms; chosen
COVARIATES = """covariates = [
    "pressure_bar",
    { column = "oil_degC", unit = "degC" },
    { column = "consumer_l_min", unit = "l/min" },
]
"""


def in_condition(rig: Rig, values: tuple[Values, ...]) -> Rig:
    """Return a rig with another mass of the implement, kg, oil temperature, °C, and pump flow, m³/s."""
    return eqx.tree_at(
        lambda rig: (rig.linkage.implement_mass, rig.oil.temperature, rig.supply.pump_flow), rig, values
    )


class Condition(NamedTuple):
    """One operating condition.

    Attributes:
        name: of its tests, such as `600kg-40C`.
        rig: the bench in this condition.
        oil_c: oil temperature, °C.
        consumer_l_min: flow that a second consumer takes from the pump, l/min.
    """

    name: str
    rig: Rig
    oil_c: float
    consumer_l_min: float

    def readings(self, pressure_pa: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Return cylinder pressure above tank, oil temperature and consumer flow as measured, shape [N]."""
        true = {
            "pressure_bar": ((pressure_pa - TANK_PRESSURE_PA) / 1e5, PRESSURE_NOISE_BAR),
            "oil_degC": (self.oil_c, OIL_NOISE_C),
            "consumer_l_min": (self.consumer_l_min, FLOW_NOISE_L_MIN),
        }
        return {
            name: value + noise * rng.standard_normal(pressure_pa.size)
            for name, (value, noise) in true.items()
        }


@dataclass(frozen=True)
class Conditions:
    """Operating conditions of which every combination is tested.

    Attributes:
        implements_kg: masses of the implement, kg; empty for that of the rig.
        oil_c: oil temperatures, °C; empty for that of the rig.
        consumer_l_min: flows that a second consumer takes from the pump before the hitch, l/min.
    """

    implements_kg: tuple[float, ...] = ()
    oil_c: tuple[float, ...] = ()
    consumer_l_min: tuple[float, ...] = (0.0,)

    def of(self, rig: Rig) -> Iterator[Condition]:
        """Yield the conditions of a rig.

        Raises:
            InputError: a value is not a number, a mass not positive, or a flow not from zero to less than
                the pump's.
        """
        pump_l_min = float(rig.supply.pump_flow) / LITRES_PER_MIN
        masses = self.implements_kg or (float(rig.linkage.implement_mass),)
        temperatures = self.oil_c or (float(rig.oil.temperature),)
        for mass, oil_c, consumer in product(masses, temperatures, self.consumer_l_min):
            checks.number(mass, "implements_kg", above=0.0)
            checks.number(oil_c, "oil_c")
            if not 0 <= checks.number(consumer, "consumer_l_min") < pump_l_min:
                raise InputError(
                    f"consumer_l_min: expected from 0 to less than the pump's {pump_l_min:.4g} l/min, "
                    f"got {consumer:g}"
                )
            # The consumer comes before the hitch, and so takes from what the pump delivers.
            values = (mass, oil_c, (pump_l_min - consumer) * LITRES_PER_MIN)
            changed = in_condition(rig, tuple(map(jnp.asarray, values)))
            flow = f"-{consumer:g}lpm" if self.consumer_l_min != (0.0,) else ""
            yield Condition(f"{mass:g}kg-{oil_c:g}C{flow}", changed, oil_c, consumer)


Protocol = Literal["prbs", "ramp", "cycle"]
REPEATS = 3  # ramps of a direction by default (chosen)
MOST_TESTS = 10_000  # tests of a kind, to limit memory (chosen)
TESTS: Mapping[Protocol, int] = MappingProxyType({"prbs": 20})
RAMP_S = 30.0  # s, length of a ramp (chosen)
DYNAMIC_S = 10.0  # s, length of a dynamic test (chosen)
CYCLE_S = 60.0  # s, length of a mixed test (chosen)
FLOW_FRACTION = 0.9  # of the pump flow; above it, the pressure compensator has too little pressure
STROKE_FRACTION = 0.6  # of the stroke that a dynamic test may travel (chosen)
TRUTH = "truth"  # folder of the true displacements
COLUMNS = """[signals]
time = "time_s"
lifting_command = "current_up_A"
lowering_command = "current_down_A"
displacement = "displacement_mm"
"""


@dataclass(frozen=True)
class Log:
    """Log of one test.

    Attributes:
        name: of its file.
        columns: column to measured samples.
        truth: displacement without sensor and noise, mm.
        pressure_pa: in the cylinder, absolute, Pa.
    """

    name: str
    columns: Mapping[str, np.ndarray]
    truth: np.ndarray
    pressure_pa: np.ndarray


def run(
    rig: Rig,
    tests: Mapping[Protocol, int] = TESTS,
    directions: Sequence[str] = DIRECTIONS,
    *,
    conditions: Conditions | None = None,
    seed: int = 0,
) -> list[Log]:
    """Run tests on a rig and return their logs.

    Static tests are ramps (Sun et al. 2025, sec. 2.3.1). They are always run: their dead zones and speeds set
    the levels of dynamic tests within stroke and pump flow. Levels are effective; the dead
    zone is added (sec. 2.3.2).

    Args:
        rig: the virtual bench.
        tests: protocol to number: ramps and `prbs` tests of each direction, cycles.
        directions: directions to excite; cycles excite both.
        conditions: operating conditions, in each of which all tests are run and cylinder pressure, oil
            temperature and consumer flow are measured, too; None for those of the rig.
        seed: seed of all random draws.

    Raises:
        InputError: a protocol or direction is unknown, a number of tests not from 1 to 10 000, or the seed
            not an integer of at least 0.
    """
    for protocol, count in checks.mapping_of(tests, get_args(Protocol), "tests").items():
        if checks.integer(count, f"tests, {protocol}", minimum=1) > MOST_TESTS:
            raise InputError(f"tests, {protocol}: expected at most {MOST_TESTS}, got {count}")
    for direction in checks.tuple_of(directions, str, "modes", "directions"):
        checks.one_of(direction, DIRECTIONS, "direction")
    checks.integer(seed, "seed")
    if conditions is not None:
        measured = []
        for number, condition in enumerate(conditions.of(rig)):
            rng = np.random.default_rng([seed, number])  # whatever the other conditions draw
            for log in run(condition.rig, tests, directions, seed=int(rng.integers(2**31))):
                columns = {**log.columns, **condition.readings(log.pressure_pa, rng)}
                measured.append(replace(log, name=f"{log.name}-{condition.name}", columns=columns))
        return measured
    excited = DIRECTIONS if "cycle" in tests else directions  # ramps also of what is not asked for
    ramps = {direction: _ramps(rig, direction, tests.get("ramp", REPEATS), seed) for direction in excited}
    static = {
        direction: evaluate_ramps([_record(log) for log in logs], direction)
        for direction, logs in ramps.items()
    }
    jobs = {
        direction: partial(_dynamic, rig, direction, static[direction], tests["prbs"], seed)
        for direction in directions
        if "prbs" in tests
    }
    if "cycle" in tests:
        jobs["cycle"] = partial(_cycles, rig, static, tests["cycle"], seed)
    # Cycles are started with the first direction: the second one then reuses its compiled program.
    results = parallel(
        lambda name: jobs[name](), sorted(jobs, key=[*directions[:1], "cycle", *directions[1:]].index)
    )
    static_logs = [ramps[direction] for direction in directions] if "ramp" in tests else []
    return [log for logs in (*static_logs, *(results[name] for name in jobs)) for log in logs]


def write_campaign(
    out: str | Path,
    rig: str | Path = "nominal",
    *,
    tests: Mapping[Protocol, int] = TESTS,
    directions: Sequence[str] = DIRECTIONS,
    conditions: Conditions | None = None,
    suffix: Literal["csv", "csv.gz", "mf4", "parquet", "tdms"] = "csv",
    seed: int = 0,
    force: bool = False,
) -> int:
    """Run tests and write one log each, the true displacements, and `campaign.toml`.

    Args:
        out: folder to write.
        rig: name or file of a parameter set.
        tests, directions, conditions, seed: see `run`.
        suffix: format of the logs.
        force: replace an older campaign.

    Returns:
        Number of logs.

    Raises:
        OutputError: the folder exists and `force` is not given, or it cannot be written.
        InputError: an argument is invalid, such as a number of tests not from 1 to 10 000.
        SettingsError: the rig's parameters cannot be used.
    """
    folder = checks.path(out, "out")
    parameters = load_rig(checks.instance(rig, (str, Path), "rig", "a name or a path"))
    logs = run(parameters, tests, directions, conditions=conditions, seed=seed)

    def fill(folder: Path) -> None:
        (folder / TRUTH).mkdir()
        # Beside the logs, not among their signals: what is identified from them must not see it.
        for log in logs:
            write_table(folder / f"{log.name}.{suffix}", log.columns)
            truth = {"time_s": log.columns["time_s"], "displacement_true_mm": log.truth}
            write_table(folder / TRUTH / f"{log.name}.{suffix}", truth)
        columns = COLUMNS if conditions is None else COLUMNS + COVARIATES
        (folder / "campaign.toml").write_text(columns, encoding="utf-8")

    write_folder(folder, fill, result_kind="campaign.toml", force=force)
    return len(logs)


def _ramps(rig: Rig, direction: str, repeats: int, seed: int) -> list[Log]:
    """Return slow ramps that end at the current at which the piston has moved 20 mm."""
    top, start = _saturation(rig, direction), _start(rig, direction)
    command = excitation.ramp(top=top, duration_s=RAMP_S)
    # As many at once as in the ramps below, so that both use one compiled program.
    currents = np.stack([two_channel_command(direction, command)] * repeats)
    motion = simulate(rig, currents, initial_displacement_m=start)
    travel_m = np.abs(np.asarray(motion.displacement_m)[0] - start)
    # A ramp to the end of its travel would spend most of its time at the stop.
    if travel_m.max() >= RAMP_TRAVEL_M:
        top = float(command[np.argmax(travel_m >= RAMP_TRAVEL_M)])
    command = two_channel_command(direction, excitation.ramp(top=top, duration_s=RAMP_S))
    names = [f"ramp-{direction}-{number:02d}" for number in range(1, repeats + 1)]
    return _logs(rig, names, [command] * repeats, [start] * repeats, seed)


def _highest_command(rig: Rig, direction: str, static: StaticResult, travel_mm: float) -> float:
    """Return the largest effective current within pump flow, valve range and travel of one test, A."""
    in_range = _saturation(rig, direction) - static.dead_zone
    in_travel = travel_mm / (static.speed_per_command * DYNAMIC_S)
    if direction != LIFTING:
        return min(in_range, in_travel)
    # Lowering is driven by the load, not by the pump.
    in_flow = FLOW_FRACTION * 1e3 * rig_limits(rig).lifting_speed_m_s / static.speed_per_command
    return min(in_range, in_travel, in_flow)


def _saturation(rig: Rig, direction: str) -> float:
    limits = rig_limits(rig)
    return limits.lifting_saturation_a if direction == LIFTING else limits.lowering_saturation_a


def _dynamic(rig: Rig, direction: str, static: StaticResult, tests: int, seed: int) -> list[Log]:
    highest = _highest_command(rig, direction, static, STROKE_FRACTION * 1e3 * rig_limits(rig).stroke_m)
    # By direction: its tests are the same whether the other one is asked for or not.
    rng = np.random.default_rng([seed, DIRECTIONS.index(direction)])
    commands = [
        two_channel_command(direction, binary_command(highest, static.dead_zone, DYNAMIC_S, rng))
        for _ in range(tests)
    ]
    names = [f"{direction}-{number:02d}" for number in range(1, tests + 1)]
    # Noise of their own: that of the seed itself is in the ramps.
    return _logs(rig, names, commands, [_start(rig, direction)] * tests, seed + 1)


def _cycles(rig: Rig, static: Mapping[str, StaticResult], tests: int, seed: int) -> list[Log]:
    stroke_mm = 1e3 * rig_limits(rig).stroke_m
    highest = {
        direction: _highest_command(rig, direction, static[direction], stroke_mm) for direction in DIRECTIONS
    }
    rng = np.random.default_rng([seed, len(DIRECTIONS)])
    commands, starts = [], []
    for _ in range(tests):
        # From somewhere in the middle the first stroke may go either way.
        start = rng.uniform(0.3, 0.7) * stroke_mm
        command = cycle_commands(
            static,
            highest,
            start_mm=start,
            # Travel is predicted from ramps; what it is wrong by must not reach a stop.
            displacement_range=(0.15 * stroke_mm, 0.85 * stroke_mm),
            duration_s=CYCLE_S,
            seed=int(rng.integers(2**31)),
        )
        commands.append(command)
        starts.append(1e-3 * start)
    return _logs(rig, [f"cycle-{number:02d}" for number in range(1, tests + 1)], commands, starts, seed + 2)


def _start(rig: Rig, direction: str) -> float:
    """Return the displacement a direction starts from, m: the bottom for lifting, the top for lowering."""
    return 0.0 if direction == LIFTING else rig_limits(rig).stroke_m


def _logs(
    rig: Rig, names: Sequence[str], commands: Sequence[np.ndarray], starts_m: Sequence[float], seed: int
) -> list[Log]:
    currents = np.stack(commands)
    motion = simulate(rig, currents, initial_displacement_m=np.asarray(starts_m))
    columns = measure(rig, motion, currents, jax.random.key(seed))
    truth, pressure_pa = 1e3 * np.asarray(motion.displacement_m), np.asarray(motion.pressure_pa)
    return [
        Log(name, {column: rows[test] for column, rows in columns.items()}, truth[test], pressure_pa[test])
        for test, name in enumerate(names)
    ]


def _record(log: Log) -> Record:
    roles = (DISPLACEMENT, *(COMMAND[direction] for direction in DIRECTIONS))
    names, units = ("displacement_mm", "current_up_A", "current_down_A"), ("mm", "A", "A")
    signals = {role: log.columns[name] for role, name in zip(roles, names, strict=True)}
    step_s = float(np.median(np.diff(log.columns["time_s"])))  # of stamps as a reader would take it
    return Record(log.name, step_s, signals, dict(zip(roles, units, strict=True)), kind=RAMP)
