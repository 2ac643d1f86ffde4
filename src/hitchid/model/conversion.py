"""Conversion of records to a model's clock and units, and of displacements back."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from hitchid._support import checks
from hitchid.data.record import DISPLACEMENT, Record
from hitchid.data.test_kinds import ACTIVE_FRACTION, effective_command, full_scales
from hitchid.data.units import conversion_factor
from hitchid.errors import InputError
from hitchid.model.channel import Channel
from hitchid.model.free_run import InitialCondition
from hitchid.model.loads import covariates_of, stacked
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
    displacement: Float[np.ndarray, "*m n"],
    units: Mapping[str, str],
    model_record: Record,
    record: Record,
) -> np.ndarray:
    """Return a displacement of the model on the record's clock and in its unit."""
    factor = conversion_factor(units[DISPLACEMENT], record.unit, record.name)
    return factor * interpolated(displacement, model_record.time_s, record.time_s)


def interpolated(
    samples: Float[np.ndarray, "*m n"], old_times_s: np.ndarray, new_times_s: np.ndarray
) -> np.ndarray:
    """Return samples interpolated from one clock to another, linearly; exact for equal clocks."""
    return np.apply_along_axis(lambda row: np.interp(new_times_s, old_times_s, row), -1, samples)


def initial_condition(
    record: Record,
    channels: Mapping[str, Channel],
    *,
    displacement: np.ndarray | None = None,
    load: Mapping[str, np.ndarray] | None = None,
) -> InitialCondition:
    """Return displacement and covariates before motion.

    Args:
        record: on the model's clock and in its units.
        channels: direction to channel.
        displacement: given values, shape [] or [M]; None for the mean before any command is effective.
        load: covariates that are given, by name, likewise; the others are those of the record.

    Raises:
        InputError: the record lacks a covariate, or given values differ in number.
    """
    effective = np.zeros(len(record))
    for direction, channel in channels.items():
        if direction in record.directions:
            effective += np.abs(effective_command(record.command(direction), channel.dead_zone))
    if displacement is None:
        displacement = np.asarray(mean_before_motion(record.displacement, effective))
    given = load or {}
    names = covariates_of(channels.values())
    signals = record.require([name for name in names if name not in given]).signals
    rows = stacked(
        [given[name] if name in given else mean_before_motion(signals[name], effective) for name in names]
    )
    try:
        runs = np.broadcast_shapes(displacement.shape, rows.shape[:-1])
    except ValueError as error:
        count = rows[..., 0].size
        raise InputError(
            f"initial and load: expected equal numbers of values, got {displacement.size} and {count}"
        ) from error
    return InitialCondition(
        np.broadcast_to(displacement, runs), np.broadcast_to(rows, (*runs, rows.shape[-1]))
    )


def _same_clock(step_s: float, wanted_s: float, samples: int) -> bool:
    return abs(step_s - wanted_s) * samples <= MAX_CLOCK_SHIFT * wanted_s
