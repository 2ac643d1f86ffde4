"""What public objects show of themselves fits on one screen, however much they hold."""

import importlib
import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from itertools import product
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import hitchid
from handmade import hitch, with_bands
from hitchid._support.screen import MAX_LINES, MAX_WIDTH
from hitchid.errors import HitchError, LogError
from hitchid.identification import ChannelTrace, Identification
from hitchid.identification.phase1 import Phase1
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import KINDS, Record
from hitchid.logs.unification import LeftOut
from hitchid.model import Simulation, TwoModes
from hitchid.structures import Structure
from hitchid.validation import Validation
from hitchid.validation.comparison import ModelComparison
from hitchid.validation.results import Accuracy, ChannelResult, CycleResult, ModelFigures, RunFigures
from report.reported import characteristics, horizons, known_estimates, predictions

ROOMS = (
    *("baselines", "bench", "bench.sun2025", "control.next_test", "estimation", "handover", "identification"),
    *("live", "logs", "logs.audit", "model", "report", "structures"),
    *("uncertainty", "validation"),
)
# Settings: their `repr` is the call that makes them, on one line, and stands in model folders.
SETTINGS = (
    *("AdamConfig", "AutoStructure", "CompensatorConfig", "DifferentialEvolution", "ExcitationLimits"),
    *("Format", "ModelSpec", "MultiStart", "Plan", "SearchComparison", "SpeedCompensatorConfig", "Whale"),
    "WhaleConfig",
)
# What a door hands on to other rooms only; no user holds one.
PARTS = ("CampaignContext", "HitchDynamics", "RecordContext", "StrokeModel", "TracedSearch")
MANY, SAMPLES = 40, 30  # items of each sequence and mapping, samples along each axis of an array
LONG_NAME = "a name that is rather long, as names of logs are at times, for they tell what was measured/up-1"
DEPTH = 4  # of records in records; deeper ones are None or left empty


def public_classes() -> list[type]:
    """Return the classes that the rooms export, but for exceptions, enumerations, interfaces and settings."""
    exported = {
        value
        for room in (hitchid, *(importlib.import_module(f"hitchid.{name}") for name in ROOMS))
        for name, value in vars(room).items()
        if inspect.isclass(value) and value.__module__.startswith("hitchid") and not name.startswith("_")
    }
    records = [
        kind
        for kind in exported
        if (is_dataclass(kind) or issubclass(kind, tuple))
        and not issubclass(kind, Structure | HitchError | Enum)
        and not inspect.isabstract(kind)
        and kind.__name__ not in (*SETTINGS, *PARTS)
    ]
    return sorted(records, key=lambda kind: f"{kind.__module__}.{kind.__name__}")


def example(hint: Any, depth: int = DEPTH) -> Any:
    """Return a value of a type that holds much of everything."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        chosen = [argument for argument in arguments if argument is not type(None)]
        return example(chosen[0], depth)
    if origin is tuple:
        repeated = len(arguments) == 2 and arguments[1] is Ellipsis
        return tuple(example(a, depth - 1) for a in ([arguments[0]] * MANY if repeated else arguments))
    if origin is not None and issubclass(origin, Mapping):
        return {f"{LONG_NAME} {number}": example(arguments[1], depth - 1) for number in range(MANY)}
    if origin is frozenset:
        return frozenset(f"{number:064x}" for number in range(MANY))
    if hasattr(hint, "dims") or hint is np.ndarray:  # an array with a shape in its type
        axes = len(getattr(hint, "dims", (0,)))
        return np.linspace(-1e9, 1e9, SAMPLES**axes).reshape((SAMPLES,) * axes)
    return example_of_class(hint, depth)


def example_of_class(kind: Any, depth: int) -> Any:
    """Return an instance of a class; of records one that no constructor has checked."""
    simple = {str: LONG_NAME, float: 1234567.891234567, int: 1234567, bool: True, Path: Path(LONG_NAME)}
    if kind in simple:
        return simple[kind]
    if inspect.isclass(kind) and issubclass(kind, Enum):
        return next(iter(kind))
    if kind in WHOLE | SIMULATED:
        return (WHOLE | SIMULATED)[kind]()
    is_record = is_dataclass(kind) or hasattr(kind, "_fields")
    if not is_record or inspect.isabstract(kind) or depth < 0:
        return None
    names = [field.name for field in fields(kind)] if is_dataclass(kind) else kind._fields
    hints = get_type_hints(kind)
    content = {name: example(hints[name], depth - 1) for name in names}
    if not is_dataclass(kind):
        return tuple.__new__(kind, content.values())
    made = object.__new__(kind)
    for name, value in content.items():
        object.__setattr__(made, name, value)
    return made


def record(name="up-01", kind="lifting", **options) -> Record:
    """Return a record with many covariates."""
    command = np.where(np.arange(200) > 5, 0.5, 0.0)
    signals = {"displacement": 7.0 + np.cumsum(command), "lifting_command": command}
    signals |= {f"{LONG_NAME} {number}": command for number in range(MANY)}
    units = dict.fromkeys(signals, "bar") | {"displacement": "mm", "lifting_command": "A"}
    return Record(name, 0.01, signals, units, kind=kind, **options)


def campaign() -> Campaign:
    """Return a campaign of many tests of every kind, with many logs left out."""
    records = tuple(record(f"{LONG_NAME} {kind} {n}", kind) for kind, n in product(KINDS, range(MANY)))
    left_out = tuple(LeftOut(f"{LONG_NAME} {n}", LogError(LONG_NAME, "broken " * 50)) for n in range(MANY))
    return Campaign(records, left_out=left_out)


def model() -> hitchid.Hitch:
    """Return a model with every part."""
    whole = hitch("integrator-second-order", compensated=True, free_run=True, shape=True, baselines=True)
    whole = with_bands(whole, "lifting", "lowering")
    uncertainty = {
        direction: replace(entry, benchmark=known_estimates(), characteristics=characteristics())
        for direction, entry in whole.uncertainty.items()
    }
    return replace(whole, uncertainty=uncertainty, two_modes=TwoModes(True, 1.0, 0.5, 12))


def identification() -> Identification:
    """Return an identification with many notices."""
    phase1 = object.__new__(Phase1)
    object.__setattr__(phase1, "rmse", 0.4261)
    traces = {}
    for direction in ("lifting", "lowering"):
        trace = object.__new__(ChannelTrace)
        for name, value in (("phase1", phase1), ("seconds", {"fit": 3.0}), ("notices", (LONG_NAME,) * MANY)):
            object.__setattr__(trace, name, value)
        traces[direction] = trace
    return Identification(model(), traces)


def accuracy() -> Accuracy:
    """Return errors of every model, one of which diverged."""
    names = ("greybox", "benchmark", "persistence", "arx", "narx", "lstm", "transfer_function", "paper")
    figures = RunFigures(0.4261, 0.3, 0.99, 97.123, 1.25, 0.9, 0.05)
    diverged = RunFigures(None, None, None, None, None, None)
    models = {name: ModelFigures(figures, diverged if name == "narx" else figures) for name in names}
    return Accuracy(models, horizons(), {}, predictions())


def validation() -> Validation:
    """Return a validation of both directions and cycles, with many notices."""
    channels = {name: ChannelResult(accuracy(), {}) for name in ("lifting", "lowering")}
    return Validation(
        "mm", channels, CycleResult(accuracy(), 0.1), None, (LONG_NAME,) * MANY, model(), campaign()
    )


def comparison() -> ModelComparison:
    """Return a comparison of two models."""
    return ModelComparison(("A", "B"), (validation(), validation()), 3, 0.01)


WHOLE: dict[type, Callable[[], object]] = {
    Record: record,
    Campaign: campaign,
    hitchid.Hitch: model,
    Identification: identification,
    Validation: validation,
    ModelComparison: comparison,
}
SIMULATED = {Simulation: lambda: hitch().simulate([0.5] * SAMPLES, step_s=0.01, initial=100.0)}


@pytest.mark.parametrize("kind", public_classes(), ids=lambda kind: kind.__name__)
def test_a_public_object_shows_itself_on_one_screen(kind):
    lines = repr(example_of_class(kind, DEPTH)).splitlines()
    assert 1 <= len(lines) <= MAX_LINES == 25
    assert max(map(len, lines)) <= MAX_WIDTH == 110
    assert kind.__name__ in lines[0] or kind in WHOLE


def test_settings_are_shown_as_the_call_that_makes_them():
    from hitchid.identification import AdamConfig

    assert eval(repr(AdamConfig(epochs=3))) == AdamConfig(epochs=3)  # noqa: S307


def test_what_a_person_wants_to_know_is_there():
    shown = {kind: repr(make()) for kind, make in WHOLE.items()}
    parts = {
        Record: ("'up-01'", "lifting", "200 samples at 0.01 s", "displacement", "mm", "7 ", "104"),
        Campaign: (f"{MANY * len(KINDS)} tests at 0.01 s", "lowering", "held out", "37 more: see .left_out"),
        hitchid.Hitch: (
            "G(s) = K / (s (s²/ωh² + 2 ξh s/ωh + 1))",
            "K = 30 ± 1 mm/(s·A)",
            "the two directions differ significantly",
        ),
        Identification: ("lifting and lowering", "0.4261 mm", "identified in 3 s", "77 more: see .channels"),
        Validation: ("3 unseen lifting tests", "3 unseen cycles", "grey box", "0.4261", "diverged"),
        ModelComparison: ("lowering: no significant difference", "RMSE free run / mm", "B"),
    }
    for kind, wanted in parts.items():
        for part in wanted:
            assert part in shown[kind], f"{kind.__name__}: {part}\n{shown[kind]}"


@pytest.mark.parametrize("kind", WHOLE, ids=lambda kind: kind.__name__)
def test_a_notebook_shows_table_and_picture_without_a_script(kind):
    page = WHOLE[kind]()._repr_html_()
    assert page.count("<table>") == page.count("</table>") == 1
    assert "<svg" in page
    assert "<script" not in page
    assert "http" not in page
    assert "nan" not in page


def test_names_are_escaped_in_a_notebook():
    page = replace(record(), name='<img src="x">')._repr_html_()
    assert "<img" not in page
    assert "&lt;img src=&quot;x&quot;&gt;" in page
