"""Experiments of a MATLAB file: structs with the fields of an `iddata`, and their clock."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from hitchid.logs.formats.library import floats, is_time, to_seconds
from hitchid.logs.formats.mat_tree import (
    NOTHING,
    ChannelSource,
    Leaf,
    Named,
    Record,
    columns_of,
    entries_of,
    first_of,
    join,
    leaves_of,
    length_of,
    lengths_of,
    number_of,
    text_of,
    texts_of,
)

# Fields of `iddata`, of Octave's, and of structs that people make: what they are called.
INPUTS, OUTPUTS, PERIODS = ("InputData", "u"), ("OutputData", "y"), ("Ts", "tsam")
OF_CLOCK, TIME_UNITS = (*PERIODS, "Tstart", "Period"), ("TimeUnit", "timeunit")
LABELS = {
    **dict.fromkeys(INPUTS, (("InputName", "inname"), ("InputUnit", "inunit"))),
    **dict.fromkeys(OUTPUTS, (("OutputName", "outname"), ("OutputUnit", "outunit"))),
}
# s and sampling times, the longer counts: between experiments of one file, more than any gap that is closed.
EXPERIMENTS_APART_S, EXPERIMENTS_APART_STEPS = 10.0, 100
SAME_STEP = 1e-3  # largest share by which sampling times of experiments may differ: rounding of clocks
EVEN, EVEN_SHARE = 0.2, 0.9  # largest deviation of a step from the median; share of such steps of a time
SAME_TIME = 0.5  # sampling times by which a vector may differ from a clock and be the same


def experiments(name: str, node: Mapping[str, object]) -> Record:
    """Read a struct with the fields of an `iddata`: one experiment, or a cell in each field for several.

    Experiments follow one another in time, so far apart that each becomes a record of its own. Vectors beside
    inputs and outputs that are as long have the same clock.
    """
    output = first_of(node, OUTPUTS)
    lengths, unit = lengths_of(node.get(output or "")), _stated_time_unit(node)
    is_in_time = text_of(node.get("Domain")) != "Frequency" and number_of(node.get("timedomain")) != 0.0
    if not lengths or unit is None or not is_in_time or first_of(node, INPUTS) is None:
        return NOTHING
    clock, is_from_period = _clock(node, lengths, unit)
    if clock is None:
        return NOTHING
    notes = [f"{len(lengths)} experiments; each becomes a record of its own"] if len(lengths) > 1 else []
    if not unit:
        notes.append("no TimeUnit says otherwise, so its sampling time is taken for s")
    # A sampling time, or one for each input or experiment, is no signal.
    used = [field for field in OF_CLOCK if field in node and lengths_of(node[field]) != lengths]
    for first, second in (INPUTS, OUTPUTS):
        shapes, twins = ([leaf.shape for leaf in leaves_of(node.get(field))] for field in (first, second))
        if shapes and shapes == twins:
            notes.append(f"{second} is as large as {first} and taken for the same")
            used.append(second)
    note = f"{name or 'the file'}: {'; '.join(notes)}" if notes else None
    pairs: Named = []
    for field in dict.fromkeys((first_of(node, INPUTS) or "", output or "", *node)):
        leaves = leaves_of(node.get(field))
        if field in used or field == "SamplingInstants" or lengths_of(node.get(field)) != lengths:
            continue
        same = next((names for names in (INPUTS, OUTPUTS) if field in names), (field,))
        columns = columns_of(join(name, field), _joined(leaves))
        stated = [first_of(node, fields) or "" for fields in LABELS.get(field, ((), ()))]
        labels, units = (texts_of(node.get(text), len(columns)) for text in stated)
        for (column, leaf), label, channel_unit in zip(columns, labels, units, strict=True):
            alias = column if field in LABELS else None
            time_unit = "s" if unit else None  # None: s by assumption alone
            channel = ChannelSource(leaf, channel_unit or None, clock, time_unit, note, is_from_period, alias)
            # A name that another field has stays that field's.
            is_free = label not in node or label in same
            pairs.append((join(name, label) if label and is_free else column, channel))
        used += [field] if columns else []
    # Without a unit they may be wanted as the time, with one that the user knows.
    return (*used, *(["SamplingInstants"] if unit else [])), pairs


def _clock(node: Mapping[str, object], lengths: Sequence[int], unit: str) -> tuple[Leaf | None, bool]:
    """Return the time of all experiments, s, one after the other, and whether it is from a sampling time.

    None where no time is stated. It is computed when it is loaded: a file may declare any length.
    """
    count = len(lengths)
    instants = entries_of(node.get("SamplingInstants"), count)
    periods = [number_of(entry) for entry in entries_of(node.get(first_of(node, PERIODS) or ""), count)]
    starts = [number_of(entry) or 0.0 for entry in entries_of(node.get("Tstart"), count)]
    stated = [
        entry if isinstance(entry, Leaf) and length_of(entry) == length == np.prod(entry.shape) else None
        for entry, length in zip(instants, lengths, strict=True)
    ]
    if any(leaf is None and not (period or 0.0) > 0 for leaf, period in zip(stated, periods, strict=True)):
        return None, False

    def load() -> np.ndarray:
        clocks = [
            to_seconds(floats(leaf.load()) if leaf else start + (period or 0.0) * np.arange(length), unit)
            for leaf, start, period, length in zip(stated, starts, periods, lengths, strict=True)
        ]
        steps = [float(np.median(np.diff(clock))) if clock.size > 1 else 0.0 for clock in clocks]
        if max(steps) - min(steps) > SAME_STEP * max(steps):
            raise ValueError(
                f"experiments with sampling times from {min(steps):.4g} to {max(steps):.4g} s; expected one, "
                "or each experiment in a file of its own: in MATLAB, s = get(getexp(data, k)) for each k"
            )
        apart = max(EXPERIMENTS_APART_S, EXPERIMENTS_APART_STEPS * steps[0])
        for number in range(1, count):
            clocks[number] = clocks[number] - clocks[number][0] + clocks[number - 1][-1] + apart
        return np.concatenate(clocks)

    # Of several experiments the instants lie in a cell, which is loaded with its file.
    variable = stated[0].variable if stated[0] else None
    return Leaf((sum(lengths),), load, variable), not unit or any(leaf is None for leaf in stated)


def _stated_time_unit(node: Mapping[str, object]) -> str | None:
    """Return the unit of time; blank where none is stated, None where one is that nobody understands."""
    stated = node.get(first_of(node, TIME_UNITS) or "")
    stated = stated[0] if isinstance(stated, list) and len(stated) == 1 else stated
    if stated is None or (isinstance(stated, str) and not stated.strip()):
        return ""
    return text_of(stated) if is_time(text_of(stated)) else None


def _joined(tables: Sequence[Leaf]) -> Leaf:
    """Return the tables of several experiments one below the other; without rows if their columns differ."""
    if len(tables) == 1:
        return tables[0]
    samples, widths = sum(map(length_of, tables)), {min(table.shape) for table in tables}

    def load() -> np.ndarray:
        loaded = [table.load() for table in tables]
        return np.concatenate([rows if rows.shape[0] == max(rows.shape) else rows.T for rows in loaded])

    return Leaf((samples if len(widths) == 1 else 0, *widths), load)


def rival_time(sources: Mapping[str, ChannelSource], selected: Iterable[ChannelSource]) -> str | None:
    """Return a vector that rises like a time, beside a sampling time that it contradicts or without unit."""
    clocks = {id(source.time): source.time for source in selected if source.from_period and source.time}
    for name, source in sources.items():
        clock = clocks.get(id(source.time))
        if clock is None or source.alias is not None:  # inputs and outputs are no time
            continue
        stamps, clock_s = floats(source.values.load()), to_seconds(floats(clock.load()), source.time_unit)
        steps = np.diff(stamps)
        # A time rises at every sample, mostly by the same.
        if (
            stamps.size == clock_s.size
            and np.all(steps > 0)
            and np.mean(np.abs(steps / np.median(steps) - 1) < EVEN) > EVEN_SHARE
        ):
            differing = np.abs(stamps - stamps[0] - (clock_s - clock_s[0]))
            if source.time_unit is None or np.max(differing) > SAME_TIME * np.median(np.diff(clock_s)):
                return name
    return None
