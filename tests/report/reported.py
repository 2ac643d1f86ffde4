"""Records that a report is made of, put together by hand: predictions, figures, traces, documents."""

import inspect
from dataclasses import asdict
from functools import cache

import numpy as np

from hitchid.logs.kinds import segments
from hitchid.logs.record import Record
from hitchid.model import (
    Characteristics,
    Estimate,
    Estimates,
    LoadOfTest,
    LoadScatter,
    MeasuredSpeed,
    Quantity,
    SearchSummary,
    SpeedPoint,
)
from hitchid.report import (
    Document,
    Finding,
    Picture,
    Pictures,
    Rating,
    ReportSection,
    Table,
    Text,
    figures,
    read_trace,
)
from hitchid.report.document import Findings
from hitchid.validation import BandFigures, Horizons, Predictions
from hitchid.validation.residuals import residual_tests
from hitchid.validation.results import BandHorizons

STEP_S = 0.01
MODELS = (
    "benchmark",
    "one_step",
    "free_run",
    "persistence",
    "lstm",
    "narx",
    "oe",
    "arx",
    "transfer_function",
)
STEPS = (1, 2, 5, 10, 20, 50, 100)


def predictions(sizes=(300, 250, 280), *, models=MODELS, band=True, seed=0):
    """Return tests of a sine with what models say of them, each a little further off than the one before."""
    rng = np.random.default_rng(seed)
    time_s = tuple(STEP_S * np.arange(size) for size in sizes)
    actual = tuple(
        100.0 + 40.0 * np.sin(seconds) + 0.02 * rng.standard_normal(seconds.size) for seconds in time_s
    )
    predicted = {
        name: tuple(y + 0.1 * (1 + number) * rng.standard_normal(y.size).cumsum() for y in actual)
        for number, name in enumerate(models)
    }
    around = predicted["free_run"] if band and "free_run" in predicted else ()
    ends = (tuple(y - 2.0 for y in around), tuple(y + 2.0 for y in around))
    return Predictions(
        tuple(f"up-{i + 1:02d}" for i in range(len(sizes))),
        time_s,
        actual,
        predicted,
        ends if around else None,
    )


def horizons(
    *, names=("persistence", "benchmark", "greybox", "arx", "narx", "lstm", "transfer_function", "paper")
):
    """Return errors over horizons."""
    errors = {
        name: tuple(0.01 * (1 + number) * step**0.7 for step in STEPS) for number, name in enumerate(names)
    }
    return Horizons(STEPS, errors, {name: tuple(0.1 * rmse for rmse in row) for name, row in errors.items()})


def residuals(*, seed=0, level=None):
    """Return tests of errors; `level` makes the errors constant."""
    rng = np.random.default_rng(seed)
    sizes = (300, 250)
    command = [np.repeat(rng.uniform(0, 0.5, size // 25), 25) for size in sizes]
    errors = [0.1 * rng.standard_normal(levels.size) + 0.3 * levels for levels in command]
    if level is not None:
        errors = [np.full(levels.size, level) for levels in command]
    displacement = [100.0 + np.cumsum(levels) for levels in command]
    speed = [levels / STEP_S for levels in command]
    return residual_tests(errors, command, displacement, speed, step_s=STEP_S)


def estimate(name="gain", *, symbol="K", unit="mm/(s·A)", value=30.0, error=1.0, interval=None, **options):
    """Return a parameter as found; without more said it is determined, to two standard errors."""
    fields = {
        "method": "Gauss-Newton",
        "bootstrap": None if error is None else (value - error, value + error),
        "lower": 0.01,
        "upper": 1000.0,
        "linear": False,
        "determined": True,
        "verdict": "determined",
        "sensitivity": 0.2,
    } | options
    ends = (value - 2 * error, value + 2 * error) if interval is None else interval
    return Estimate(name=name, symbol=symbol, unit=unit, value=value, error=error, interval=ends, **fields)


def _vague(name, symbol, unit, value, interval, verdict):
    return estimate(
        name,
        symbol=symbol,
        unit=unit,
        value=value,
        error=None,
        interval=interval,
        determined=False,
        verdict=verdict,
    )


ESTIMATES = (
    estimate(),
    _vague("time_constant", "τ", "s", 0.02, (None, 0.05), "not determined"),
    _vague("natural_frequency", "ωh", "rad/s", 90.0, (40.0, None), "too fast"),
    _vague("damping_ratio", "ξh", "1", 0.6, (None, None), "any"),
    estimate(
        "curvature", symbol="curvature", unit="1", value=0.0, error=0.05, linear=True, lower=-1.0, upper=1.0
    ),
)


def known_estimates(*parameters):
    """Return parameters as a model holds them."""
    return Estimates(parameters or ESTIMATES, (), (), 5, 5)


def characteristics(unit="mm"):
    """Return operating characteristics at three levels and three loads, one end of them open."""
    points = tuple(
        SpeedPoint.of(level, load, speed, (0.9 * speed, 1.1 * speed if level < 0.8 else None), 30.0)
        for level in (0.4, 0.6, 0.8)
        for load in (90.0, 120.0, 150.0)
        for speed in [60.0 * (level - 0.3) * (1 - load / 500)]
    )
    return Characteristics(
        command_unit="A",
        speed_unit=f"{unit}/s",
        load="head_pressure",
        dead_zone=Quantity("dead zone", "A", 0.3, (0.29, 0.31), True),
        opening=Quantity("opening", "A", 0.32, (0.3, 0.34), True),
        level=0.6,
        delay=Quantity("delay", "s", 0.05, (0.04, 0.06), True),
        response_time=Quantity("response time", "s", 0.12, (0.1, None), False),
        speed_map=points,
        measured=(MeasuredSpeed(0.4, 92.0, 4.5), MeasuredSpeed(0.8, 148.0, 20.5)),
    )


def load_scatter():
    """Return speeds of three tests, one 4 % fast."""
    speeds = {"up-01": -0.02, "up-02": -0.02, "up-03": 0.04}
    tests = tuple(LoadOfTest(name, speed, (speed - 0.01, speed + 0.01)) for name, speed in speeds.items())
    return LoadScatter(0.035, (0.018, 0.22), 0.01, tests)


def trace(*parameters, **options):
    """Return how one direction was identified."""
    return read_trace({"lifting": trace_json(*parameters, **options)})["lifting"]


def trace_json(*parameters, iterations=20, candidates=3, phase2=True, notices=("the search ended early",)):
    """Return how one direction was identified, in the form of `trace.json`."""
    estimates = parameters or ESTIMATES[:2]
    falling = np.linspace(2.0, 1.0, iterations)
    names = [f"structure {number}" for number in range(candidates)]
    return {
        "dead_zone": {"value": 0.35, "spread": 0.01, "count": 2, "origin": "ramps"},
        "phase1": {
            "uncertainty": {"parameters": [asdict(parameter) for parameter in estimates]},
            "fitness": [None, *(1.5 * falling[1:]).tolist()],
            "searched": [parameter.name for parameter in estimates],
            "values": [[(parameter.value or 0.1) * factor for parameter in estimates] for factor in falling],
        },
        "phase2": {
            "training_loss": [None, *np.geomspace(1.0, 0.01, iterations - 1).tolist()],
            "validation_loss": np.geomspace(1.5, 0.05, iterations).tolist(),
            "best_epoch": iterations - 2,
            "reason": "patience",
        }
        if phase2
        else None,
        "candidates": [
            {
                "name": name,
                "rmse": 0.5 + index,
                "held_out_rmse": 0.7 + index if index else None,
                "chosen": index == 0,
            }
            for index, name in enumerate(names)
        ],
        "notices": list(notices),
    }


def searches():
    """Return searches compared; one seed of one of them failed."""
    return tuple(
        SearchSummary(
            name=name,
            rmse=(end, 1.1 * end, None if name == "whale" else 1.2 * end),
            evaluations=(600, 590, 610),
            failures=(0, 0, 1),
            median_rmse=(None, 3.0, 2.0, 1.1 * end),
            median_values=((1.0,),) * 4,
        )
        for name, end in (("whale", 1.0), ("differential-evolution", 0.9), ("multi-start", 0.8))
    )


def bands(*, covered=0.9, ahead=0.93):
    """Return coverage of bands."""
    horizons = BandHorizons(STEPS, (ahead,) * len(STEPS), (0.5,) * len(STEPS))
    return BandFigures(0.9, covered, 0.01, 2.0, horizons=horizons)


def mixed(*names):
    """Return mixed records with their stretches, as the timeline is drawn from: up, and down again."""
    up, down = np.repeat([0, 1.0, 0, 0], 50), np.repeat([0, 0, 0, 1.0], 50)
    signals = {"displacement": np.cumsum(up - down), "lifting_command": up, "lowering_command": down}
    units = {role: "mm" if role == "displacement" else "A" for role in signals}
    records = [Record(name, STEP_S, signals, units) for name in names]
    return [(record, segments(record)) for record in records]


TABLE = Table(
    "lifting: accuracy",
    ("model", "RMSE / mm", "95 %", "largest", "run"),
    (
        ("grey box", "0.578 ± 0.086", "28.1 … 31.9", "> 988", "free run"),
        ("NARX", "diverged", "any", "1.2e-05", "one step"),
        ("ARX", "-0.5", "< 0.3", "", "free run"),
    ),
)
FINDINGS = (
    Finding(Rating.GOOD, "The free run keeps up."),
    Finding(Rating.CAUTION, "A baseline is near."),
    Finding(Rating.BAD, "The band is too narrow."),
)


@cache
def _small():
    """Return a small figure, drawn once."""
    return sketch("horizons", horizons(names=("persistence", "greybox")), STEP_S, "mm")


def picture(name="curve", *, caption="What is seen.", alt="Error over the horizon.", wide=False):
    """Return a small figure as a report holds it."""
    return Picture(name, _small(), caption, alt, wide=wide)


def document(*, said="A paragraph.", table=TABLE, items=None, title="A report", notices=("Mind the gap.",)):
    """Return a report with a block of every kind, sections in sections among them."""
    pictures = Pictures(items or (picture(), picture("long", wide=True)))
    below = ReportSection(
        "Details", (Text(said), pictures), (ReportSection("Finer", (table, Findings(FINDINGS))),)
    )
    return Document(
        title=title,
        subtitle=f"of {said}",
        verdict=FINDINGS,
        notices=notices,
        sections=(
            ReportSection("Mixed cycles", (table, Text(said)), (below,)),
            ReportSection("Logs", (Findings(FINDINGS),)),
        ),
    )


PAPER = ("one_step", "free_run", "benchmark")
RIVALS = ("lstm", "narx", "arx", "transfer_function", "benchmark", "free_run")
# What each figure of the report is drawn of, with displacements in a unit.
DRAWN = {
    "convergence": lambda unit: (trace().phase1, unit),
    "coverage": lambda unit: (bands(), STEP_S),
    "error_distribution": lambda unit: (
        {name: predictions().errors(name) for name in ("one_step", "free_run")},
        unit,
    ),
    "errors_by_test": lambda unit: (predictions(), unit, RIVALS),
    "horizons": lambda unit: (horizons(), STEP_S, unit),
    "intervals": lambda unit: ("title", ESTIMATES),
    "loads": lambda unit: (load_scatter(),),
    "losses": lambda unit: (trace().phase2,),
    "outputs": lambda unit: (predictions(), unit, PAPER),
    "predicted_errors": lambda unit: (dict.fromkeys(("training", "validation"), predictions()), unit),
    "residual_correlations": lambda unit: (residuals(),),
    "residuals_by_variable": lambda unit: (residuals(), unit, "A"),
    "searches": lambda unit: (searches(), unit),
    "speed_map": lambda unit: (characteristics(unit),),
    "structures": lambda unit: (trace().candidates, unit, None),
}


def sketch(name, *shown):
    """Return what the function of a figure draws, whatever the picture is called and its words are."""
    figure = getattr(figures, name)
    words = dict.fromkeys({"caption", "alt"} & set(inspect.signature(figure).parameters), "")
    return figure("name", *shown, **words).figure
