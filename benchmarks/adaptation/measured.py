"""Measured machines: the model adapted to the logs so far, and the frozen one, run over the next log."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from benchmarks.adaptation.figure import Figure
from benchmarks.scheduling import FAST, show

import hitchid
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import CYCLE, DISPLACEMENT, Record
from hitchid.model import Hitch

DATA = Path(os.environ.get("HITCHID_DATA", Path(__file__).parents[3] / "shared" / "data"))
ORDERS = 10  # random ones of the boom's records with the heavy bucket
Squares = list[tuple[float, float, int]]  # sums of squared errors, adapted and frozen, and their samples


def measured() -> list[Figure]:
    """Return what adaptation gains on logs that come later, on the logs of two excavators."""
    figures = []
    for name, judge in (("field-excavator", field_excavator), ("excavator-boom", excavator_boom)):
        if not (DATA / name).is_dir():
            show(f"measured: {DATA / name} is missing")
            continue
        figures.append(judged(name, *judge(hitchid.read(DATA / name))))
    return figures


def field_excavator(given: Campaign) -> tuple[Hitch, dict[str, Squares]]:
    """Return the model of the first log, and its errors on the others, one after the other."""
    first, *later = given.records
    model = hitchid.identify(replace(given, records=(first,)), **FAST).model
    return model, log_by_log(model, given, later)


def excavator_boom(given: Campaign) -> tuple[Hitch, dict[str, Squares]]:
    """Return the model of the light bucket, and its errors on the records of the heavy one."""
    light, heavy = (
        [record for record in given.records if record.name.endswith(bucket)] for bucket in ("light", "heavy")
    )
    model = hitchid.identify(replace(given, records=tuple(light)), **FAST).model
    squares: dict[str, Squares] = {}
    for seed in range(ORDERS):
        order = np.random.default_rng(seed).permutation(len(heavy))
        for kind, rows in log_by_log(model, given, [heavy[number] for number in order]).items():
            squares.setdefault(kind, []).extend(rows)
    return model, squares


def log_by_log(model: Hitch, given: Campaign, logs: Sequence[Record]) -> dict[str, Squares]:
    """Return kind of motion to the errors over each log but the first, of the model adapted before it.

    Strokes of mixed logs are cut as `hitchid.validate` does; the whole of such a log is `cycle`.
    """
    squares: dict[str, Squares] = {}
    for number, following in enumerate(logs[1:], 1):
        adaptation = model.adapt(logs[:number])
        for kind, record in parts(model, replace(given, records=(following,))):
            pair = [squared(each, record) for each in (adaptation.model, model)]
            squares.setdefault(kind, []).append((*[total for total, _ in pair], pair[0][1]))
    return squares


def parts(model: Hitch, log: Campaign) -> Iterator[tuple[str, Record]]:
    """Yield the strokes of a log with their directions, and the whole of one that has both."""
    (record,) = log.records
    if record.kind != CYCLE:
        yield record.kind, record
        return
    yield CYCLE, record
    for stroke in log.segmented(model.segmentation_dead_zones(log.units)).records:
        yield stroke.kind, stroke


def squared(model: Hitch, record: Record) -> tuple[float, int]:
    """Return the sum of the squared errors of a free run over a record, and its number of samples."""
    measured = model.to_model_units(record).displacement
    errors = np.asarray(model.simulate(record).displacement)[: len(measured)] - measured
    return float(np.nansum(errors**2)), int(np.isfinite(errors).sum())


def judged(name: str, model: Hitch, squares: dict[str, Squares]) -> Figure:
    """Return the error of the adapted model over that of the frozen one, over all logs that came later."""
    whole = squares.get(CYCLE) or [row for rows in squares.values() for row in rows]
    for kind, rows in {**squares, "all": whole}.items():
        adapted, frozen = errors(rows)
        show(
            f"{name}, {kind}: {adapted:.3g} {model.units[DISPLACEMENT]} adapted, {frozen:.3g} frozen, over "
            f"{len(rows)} that came later"
        )
    adapted, frozen = errors(whole)
    line = f"{name}: error on the logs that came later over that of the frozen model"
    return Figure(line, float(adapted / frozen), most=1.0)


def errors(rows: Squares) -> np.ndarray:
    """Return the root mean square errors of adapted and frozen model."""
    adapted, frozen, samples = np.sum(rows, axis=0)
    return np.sqrt(np.array([adapted, frozen]) / samples)
