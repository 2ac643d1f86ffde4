"""What records and campaigns show of themselves."""

from collections.abc import Sequence

import numpy as np

from hitchid._support.numbers import count
from hitchid._support.screen import first_notes, first_to_last, sparkline
from hitchid._support.tables import Table
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import COMMAND, CYCLE, DIRECTIONS, DISPLACEMENT, KINDS, Record

MAX_LEFT_OUT = 3  # logs left out that are named; chosen


def record_summary(record: Record) -> Table:
    """Return name, kind, sampling and the range of every signal."""
    rows = [
        (role, record.units[role], f"{np.min(samples):.6g}", f"{np.max(samples):.6g}")
        if samples.size
        else (role, record.units[role], "", "")
        for role, samples in record.signals.items()
    ]
    source = [] if record.source is None else [f"read from {record.source}"]
    notices = [f"{count(len(record.notices), 'notice')}: see .notices"] if record.notices else []
    return Table(
        f"Record '{record.name}': {record.kind}, {count(len(record), 'sample')} at {record.step_s:g} s, "
        f"{_duration_s(record):g} s",
        ("signal", "unit", "lowest", "highest"),
        tuple(rows),
        (*source, *notices),
        tuple(_picture(record, [role], f"{role} over time") for role in record.signals),
    )


def campaign_summary(campaign: Campaign) -> Table:
    """Return the number of tests of each kind, how many are held out, units, and what is left out."""
    kinds = [kind for kind in KINDS if campaign.of_kind(kind)]
    title = f"Campaign of {count(len(campaign), 'test')}"
    if kinds:
        units = ", ".join(f"{role} in {unit}" for role, unit in campaign.units.items())
        title += f" at {campaign.step_s:g} s: {units}"
    rows, pictures = [], []
    for kind in kinds:
        tests = campaign.of_kind(kind)
        held_out = str(len(campaign.held_out(kind))) if kind in (*DIRECTIONS, CYCLE) else ""
        duration = f"{sum(map(_duration_s, tests)):.4g} s"
        names = first_to_last([record.name for record in tests])
        rows.append((kind, str(len(tests)), held_out, duration, names))
        roles = [role for role in (DISPLACEMENT, *COMMAND.values()) if role in tests[0].signals]
        pictures.append(_picture(tests[0], roles, f"displacement and commands of {tests[0].name}"))
    left_out = [f"left out: {item.name}: {item.reason}" for item in campaign.left_out]
    return Table(
        title,
        ("kind", "tests", "held out", "duration", "names"),
        tuple(rows),
        first_notes(left_out, MAX_LEFT_OUT, "left_out"),
        tuple(pictures),
    )


def _picture(record: Record, roles: Sequence[str], label: str) -> str:
    """Return signals as a small picture; commands share a scale that begins at zero."""
    # Commands on scales of their own would make noise on an idle valve look like a full stroke.
    commands = [record.signals[role] for role in COMMAND.values() if role in record.signals]
    shared = np.concatenate([np.zeros(1), *commands])
    scales = [shared if role in COMMAND.values() else record.signals[role] for role in roles]
    return sparkline([record.signals[role] for role in roles], label, scales)


def _duration_s(record: Record) -> float:
    return float(f"{(len(record) - 1) * record.step_s:.6g}")
