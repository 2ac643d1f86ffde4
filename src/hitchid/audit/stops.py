"""Where the piston stands at an end stop although its command goes on."""

import numpy as np

from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Look
from hitchid.data.record import CYCLE, MODES
from hitchid.data.segmentation import AT_END_FRACTION, END_STOP, segments
from hitchid.data.test_kinds import end_stop_contact

PIECE = 2**19


def end_stops(look: Look) -> list[AuditFinding]:
    """Find contact with an end stop.

    In tests of one direction by `modes.end_stop_contact`, in mixed ones by `segments.segments`; a note, for
    identification leaves out what stands at an end stop that two tests meet.
    """
    record = look.record
    if record.kind == CYCLE:
        stretches = _in_cycle(look)
    elif record.kind in MODES:
        contact = end_stop_contact(record, record.kind)
        on = np.flatnonzero(look.active(record.kind))
        stretches = [] if contact is None else [(contact, int(on[-1]) + 1)]
        stretches = [each for each in stretches if _stands(look, *each)]
    else:
        stretches = []
    if not stretches:
        return []
    time = sum(stop - start for start, stop in stretches) * record.step_s
    start, stop = stretches[0]
    place = float(np.median(record.displacement[start:stop]))
    return [
        look.finding(
            "end stop",
            Level.NOTE,
            f"the piston stands at {place:.5g} {record.unit} under command from "
            f"{record.start_s + start * record.step_s:.6g} s on, {time:.3g} s in all",
            "end tests before the stop: samples at it tell nothing of the valve",
            at=stretches,
        )
    ]


def _stands(look: Look, start: int, stop: int) -> bool:
    """Tell contact from a spike, which also leaves the displacement slow in comparison."""
    place = look.record.displacement[start:stop]
    quarter = max(1, place.size // 4)
    moved = abs(float(np.median(place[-quarter:])) - float(np.median(place[:quarter])))
    return moved <= max(look.quality.sure, AT_END_FRACTION * look.quality.reach)


def _in_cycle(look: Look) -> list[tuple[int, int]]:
    """Return samples `start:stop` of contact; of a long record piece by piece, to keep memory low."""
    record, found = look.record, []
    near = AT_END_FRACTION * look.quality.reach
    for first in range(0, len(record), PIECE):
        piece = record.slice(first, min(len(record), first + PIECE))
        for segment in segments(piece, look.scales):
            if segment.label != END_STOP:
                continue
            place = float(np.median(piece.displacement[segment.start : segment.stop]))
            # The end of a piece's travel need not be the end of the record's.
            if place >= look.quality.highest - near or place <= look.quality.lowest + near:
                found.append((first + segment.start, first + segment.stop))
    return found
