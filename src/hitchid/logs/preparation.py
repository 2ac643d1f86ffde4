"""Preparation of one record: trimmed, detrended, filtered, decimated; each adds a notice. See `Record`."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hitchid._support import checks
from hitchid._support.records import Notice
from hitchid.errors import InputError
from hitchid.logs.record import COMMAND, Record
from hitchid.logs.resampling import GRID_TOLERANCE

DISPLAY_ORDER = 2  # of the filter for display, run twice; chosen
# Order of the filter before decimation, and its cutoff as a share of half the new sampling rate; chosen:
# run twice, it reduces what would be folded onto lower frequencies by 20 log10(1 + (1/0.6)^16) = 71 dB.
DECIMATION_ORDER, DECIMATION_CUTOFF = 8, 0.6


def trim(record: Record, start_s: float | None, stop_s: float | None) -> Record:
    """Return the samples between two times; see `Record.trim`."""
    time_s, tolerance_s = record.time_s, GRID_TOLERANCE * record.step_s
    start = float(time_s[0]) if start_s is None else checks.number(start_s, "start_s")
    stop = float(time_s[-1]) if stop_s is None else checks.number(stop_s, "stop_s")
    rows = np.flatnonzero((time_s >= start - tolerance_s) & (time_s <= stop + tolerance_s))
    if rows.size < 2:
        raise InputError(
            f"record '{record.name}': expected at least 2 samples from {start:g} s to {stop:g} s, got "
            f"{rows.size}; it lasts from {time_s[0]:g} s to {time_s[-1]:g} s"
        )
    trimmed = record.slice(int(rows[0]), int(rows[-1]) + 1)
    first, last = trimmed.time_s[0], trimmed.time_s[-1]
    sentence = f"trimmed to {first:g} s … {last:g} s, {len(trimmed)} of {len(record)} samples"
    return _with_notice(trimmed, "trimmed", sentence)


def detrend(record: Record, signals: Sequence[str]) -> Record:
    """Return the record without the linear trend of measured signals; see `Record.detrend`."""
    if len(record) < 2:
        raise InputError(f"record '{record.name}': expected at least 2 samples, got {len(record)}")
    # Centred: slope and mean are then independent, and the mean of the signal stays.
    time_s = record.time_s - record.time_s.mean()
    for role in _measured(record, signals):
        samples = record.signals[role]
        slope = float(time_s @ (samples - samples.mean()) / (time_s @ time_s))
        sentence = f"detrended: {role} without its slope of {slope:.4g} {record.units[role]}/s"
        record = _mapped(record, (role,), lambda y, slope=slope: y - slope * time_s)
        record = _with_notice(record, "detrended", sentence)
    return record


def low_pass(record: Record, cutoff_hz: float, signals: Sequence[str]) -> Record:
    """Return the record with measured signals filtered for display; see `Record.low_pass`."""
    highest_hz = 0.5 / record.step_s
    if not checks.number(cutoff_hz, "cutoff_hz", above=0.0) < highest_hz:
        raise InputError(
            f"cutoff_hz: expected a frequency below half the sampling rate, {highest_hz:g} Hz, got "
            f"{cutoff_hz:g}"
        )
    # Slower than the record is long, the filter shows only how it was started.
    lowest_hz = 1 / (len(record) * record.step_s)
    if cutoff_hz < lowest_hz:
        raise InputError(
            f"cutoff_hz: expected at least {lowest_hz:.4g} Hz, one period in the record, got {cutoff_hz:g}"
        )
    roles = _measured(record, signals)
    filtered = _mapped(record, roles, lambda y: _zero_phase(y, cutoff_hz / highest_hz, DISPLAY_ORDER))
    sentence = (
        f"low-pass filtered at {cutoff_hz:g} Hz for display: {', '.join(roles)}; each sample depends on "
        "later ones, so do not identify from it"
    )
    return _with_notice(filtered, "low-pass", sentence)


def decimate(record: Record, factor: int) -> Record:
    """Return every `factor`-th sample, measured signals filtered before; see `Record.decimate`."""
    checks.integer(factor, "factor", minimum=2)
    largest = int(len(record) * DECIMATION_CUTOFF / 2)
    if factor > largest:
        raise InputError(
            f"factor: expected at most {largest}, a period of the filter in the {len(record)} samples of the "
            f"record, got {factor}"
        )
    filtered = _mapped(
        record, _measured(record, ()), lambda y: _zero_phase(y, DECIMATION_CUTOFF / factor, DECIMATION_ORDER)
    )
    step_s = factor * record.step_s
    decimated = replace(
        filtered,
        step_s=step_s,
        signals={role: samples[::factor] for role, samples in filtered.signals.items()},
        clock=replace(record.clock, logged_step_s=record.clock.logged_step_s or record.step_s),
    )
    sentence = f"decimated from {record.step_s:.4g} s to {step_s:.4g} s, measured signals filtered before"
    return _with_notice(decimated, "decimated", sentence)


def _measured(record: Record, signals: Sequence[str]) -> tuple[str, ...]:
    """Return the named measured signals, by default all."""
    measured = tuple(role for role in record.signals if role not in COMMAND.values())
    return tuple(checks.one_of(role, measured, "signals") for role in signals) or measured


def _mapped(record: Record, roles: Sequence[str], work: Callable[[np.ndarray], np.ndarray]) -> Record:
    changed = {role: work(record.signals[role]) for role in roles}
    return replace(record, signals={**record.signals, **changed})


def _with_notice(record: Record, code: str, sentence: str) -> Record:
    return replace(record, notices=(*record.notices, Notice(code, sentence)))


def _zero_phase(samples: np.ndarray, cutoff: float, order: int) -> np.ndarray:
    """Filter forwards and backwards, continued by one period of the cutoff beyond both ends.

    |H(f)|² = 1 / (1 + (f/f_c)^(2 order)) in both runs together, f_c = `cutoff` times half the sampling rate.
    """
    from scipy import signal  # not at the top: half a second

    sections = signal.butter(order, cutoff, output="sos")
    padding = min(samples.size - 1, round(2 / cutoff))
    return signal.sosfiltfilt(sections, samples, padlen=padding)
