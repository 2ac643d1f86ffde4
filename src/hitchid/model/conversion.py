"""Conversion of records to a model's clock and units, and of displacements back."""

from collections.abc import Mapping, Sequence

import numpy as np

from hitchid._support import checks
from hitchid.data.record import DISPLACEMENT, Record
from hitchid.data.test_kinds import ACTIVE_FRACTION, effective_command, full_scales
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model.channel import Channel
from hitchid.model.free_run import InitialCondition
from hitchid.structures import mean_before_motion

MAX_CLOCK_SHIFT = 0.05  # share of a sampling time that two clocks may differ over a whole record; chosen


def to_model_units(
    record: Record, directions: Sequence[str], units: Mapping[str, str], step_s: float
) -> Record:
    """Return a record on a model's clock and in its units; see `Hitch.to_model_units`."""
    checks.instance(record, Record, "record", 'one of hitchid.read("logs").records')
    if not any(direction in record.directions for direction in directions):
        raise InputError(
            f"record '{record.name}' has commands for {' and '.join(record.directions)}; "
            f"the model has channels for {' and '.join(directions)}"
        )
    converted = record.convert({role: unit for role, unit in units.items() if role in record.signals})
    resampled = (
        converted if _same_clock(converted.step_s, step_s, len(converted)) else converted.resample(step_s)
    )
    scales = full_scales([record])
    for direction in record.directions:
        active = np.abs(record.command(direction)) > ACTIVE_FRACTION * scales[direction]
        if direction not in directions and np.any(active):
            raise InputError(
                f"record '{record.name}': its {direction} command is not zero; the model has no {direction} "
                "channel"
            )
    return resampled


def to_record_units(
    displacement: np.ndarray, units: Mapping[str, str], model_record: Record, record: Record
) -> np.ndarray:
    """Return a displacement of the model on the record's clock and in its unit."""
    factor = conversion_factor(units[DISPLACEMENT], record.unit, record.name)
    if model_record.step_s != record.step_s:
        displacement = np.interp(record.time_s, model_record.time_s, displacement)
    return displacement * factor


def initial_condition(record: Record, channels: Mapping[str, Channel]) -> InitialCondition:
    """Return displacement and covariate before motion: means before any command is effective."""
    effective = np.zeros(len(record))
    for direction, channel in channels.items():
        if direction in record.directions:
            effective += np.abs(effective_command(record.command(direction), channel.dead_zone))
    load = next((c.benchmark.covariate for c in channels.values() if c.benchmark.covariate), None)
    record.require(load)
    return InitialCondition(
        mean_before_motion(record.displacement, effective),
        0.0 if load is None else mean_before_motion(record.signals[load], effective),
    )


def _same_clock(step_s: float, wanted_s: float, samples: int) -> bool:
    return abs(step_s - wanted_s) * samples <= MAX_CLOCK_SHIFT * wanted_s
