"""Check for a piston at an end stop under command."""

import numpy as np

from hitchid._support.notices import Severity
from hitchid.audit.context import RecordContext
from hitchid.audit.finding import AuditFinding
from hitchid.data.record import CYCLE, DIRECTIONS
from hitchid.data.segmentation import AT_END_FRACTION, END_STOP, segments
from hitchid.data.test_kinds import end_stop_contact

CHUNK_SAMPLES = 2**19  # samples of a long record examined at once, to limit memory (chosen)


def end_stops(context: RecordContext) -> list[AuditFinding]:
    """Find contact with an end stop.

    By `end_stop_contact` in tests of one direction, by `segments` in mixed ones; a note, since identification
    leaves out samples at an end stop reached in two tests.
    """
    record = context.record
    if record.kind == CYCLE:
        stretches = _cycle_contacts(context)
    elif record.kind in DIRECTIONS:
        contact = end_stop_contact(record, record.kind)
        active_samples = np.flatnonzero(context.active(record.kind))
        stretches = [] if contact is None else [(contact, int(active_samples[-1]) + 1)]
        stretches = [stretch for stretch in stretches if _is_stationary(context, *stretch)]
    else:
        stretches = []
    if not stretches:
        return []
    time = sum(stop - start for start, stop in stretches) * record.step_s
    start, stop = stretches[0]
    stop_position = float(np.median(record.displacement[start:stop]))
    return [
        context.finding(
            "end stop",
            Severity.NOTE,
            f"the piston stays at {stop_position:.5g} {record.unit} under command from "
            f"{record.start_s + start * record.step_s:.6g} s, {time:.3g} s in total",
            "end tests before the stop: samples at the stop contain no information on the valve",
            intervals=stretches,
        )
    ]


def _is_stationary(context: RecordContext, start: int, stop: int) -> bool:
    """Return whether the displacement is constant: `end_stop_contact` misjudges a record with a spike."""
    displacement = context.record.displacement[start:stop]
    quarter = max(1, displacement.size // 4)
    travel = abs(float(np.median(displacement[-quarter:])) - float(np.median(displacement[:quarter])))
    return travel <= max(context.quality.noise_bound, AT_END_FRACTION * context.quality.peak_to_peak)


def _cycle_contacts(context: RecordContext) -> list[tuple[int, int]]:
    """Return samples `start:stop` of contact; a long record is examined in chunks, to limit memory."""
    record, contacts = context.record, []
    margin = AT_END_FRACTION * context.quality.peak_to_peak
    for first in range(0, len(record), CHUNK_SAMPLES):
        chunk = record.slice(first, min(len(record), first + CHUNK_SAMPLES))
        for segment in segments(chunk, context.scales):
            if segment.label != END_STOP:
                continue
            stop_position = float(np.median(chunk.displacement[segment.start : segment.stop]))
            # An extreme of a chunk need not be an extreme of the record.
            if (
                stop_position >= context.quality.highest - margin
                or stop_position <= context.quality.lowest + margin
            ):
                contacts.append((first + segment.start, first + segment.stop))
    return contacts
