"""Proposal of a `campaign.toml` from the channels of logs, every guess with its reason."""

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import permutations
from math import ceil, log10
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hitchid._support.inert import printable, toml_text
from hitchid.errors import InputError
from hitchid.logs.audit import CommandResponse, campaign_context, find_end_stops, rest_level
from hitchid.logs.campaign import Campaign
from hitchid.logs.content import ChannelSelection, Content, LogChannel
from hitchid.logs.kinds import ACTIVE_FRACTION
from hitchid.logs.log_table import records_of, table_of
from hitchid.logs.motion import Windows, windows
from hitchid.logs.reader_process import ReaderProcess
from hitchid.logs.reading import find_logs, read_content, settings_of
from hitchid.logs.record import DISPLACEMENT
from hitchid.logs.signal_map import DIMENSIONS, signal_map_of
from hitchid.logs.unification import refuse, split_usable
from hitchid.logs.units import UNITS, parse_unit, unit_of_column

# Role and unit of a column from its name and range.


def _list(text: str) -> frozenset[str]:
    return frozenset(text.split())


COMMAND = _list("cmd command duty pwm current curr valve strom ctrl control drive joystick rpm")
POSITION = _list(
    "position pos displacement stroke travel angle ang height length weg hub winkel lage extension"
)
NO_COMMAND = _list("feedback fb measured actual act ist ref reference setpoint target soll")
AXIS = _list("boom hitch lift lifting hub hubwerk kraftheber")
UP = _list("up raise lift lifting heben extend out rise auf")
DOWN = _list("down dn lower lowering senken retract in fall ab")
PRESSURE = _list("pressure press druck p")
LOADED_SIDE = _list("head cap bottom piston h load")
ANGLE = _list("angle ang winkel")
VALVE = _list("valve ventil solenoid sol coil magnet spule")
RATIO = _list("duty pwm percent pct ratio")
CURRENT = _list("current curr strom")
TIME = _list("time zeit timestamp zeitstempel uhrzeit stamp datetime date datum t")
ANALOG_V = 10.5  # V, range of a 10 V analogue input with 5 % margin
SERVO_NEUTRAL = (6.5, 8.5)  # percent, around 7.5: neutral pulse of a servo, 1.5 ms of 20 ms (limits chosen)


def words(name: str) -> frozenset[str]:
    """Return the words of a column's name, in lower case: boom, up, h, cyl, p for `Boom_UpH_Cyl_P`."""
    return frozenset(word.lower() for word in re.findall(r"[A-Z]?[a-zµ°%]+|[A-Z]+(?![a-z])", name))


def stated_unit(name: str, unit: str | None) -> tuple[str | None, str]:
    """Return the unit stated by the file or the column's name, or None, and its source."""
    if file_unit := parse_unit(unit or ""):
        return file_unit, "unit from the file"
    last = re.split(r"[^A-Za-z%°µ]+", name.strip(")] "))[-1]
    name_unit = unit_of_column(name) or (parse_unit(last) if len(last) > 1 and last != name else None)
    return name_unit, "unit from its name"


def unit_of(
    role: str, name: str, unit: str | None, largest: float, zero: float | None = None
) -> tuple[str, str]:
    """Return the unit of a signal and its source: the file, the name, or a guess from the largest reading.

    The neutral reading of a command for a servo, 1.5 ms in 20 ms, is a `zero` of 7.5 percent.
    """
    stated, source = stated_unit(name, unit)
    if stated is not None and UNITS[stated].dimension in DIMENSIONS[role]:
        return stated, source
    name_words = words(name)
    if role == "displacement":
        guess = (
            "deg" if name_words & ANGLE else "V" if "position" in name_words and largest <= ANALOG_V else "mm"
        )
    elif name_words & RATIO:
        guess = "percent" if largest > 1.05 else "1"
    elif name_words & CURRENT or (name_words & VALVE and largest > 105):
        guess = "A" if largest <= 5 else "mA"
    elif zero is not None and SERVO_NEUTRAL[0] < zero < SERVO_NEUTRAL[1]:
        guess = "percent"
    elif largest > 105:
        guess = "rpm"
    else:
        guess = "1" if largest <= 1.05 else "V" if largest <= ANALOG_V else "percent"
    return guess, "unit guessed from name and range: check it"


MAX_LOGS, MAX_SHOWN = 24, 6  # logs read, evenly spread; pressures named (chosen)
# Of the intervals of a time column: not negative, and positive, at least (chosen).
INCREASING_FRACTION, RISING_FRACTION = 0.99, 0.8
# Days since 1900 or year 0 in logs of 1954 to 2119; longest sampling time of such dates, d, 8.6 s (chosen).
DATES_D, LONGEST_DATE_STEP_D = ((20_000.0, 80_000.0), (713_000.0, 774_000.0)), 1e-4
EPOCHS = (("s", 1e9), ("ms", 1e12), ("us", 1e15), ("ns", 1e18))  # least stamp since 1970 (2001) in a unit
MAX_STEP_RATIO = 0.05  # mean one-step change over the range of a displacement, at most (chosen)
# Correlation of each of two one-sided commands; share of the unexplained variance that both explain (chosen).
MIN_PAIR_CORRELATION, MIN_PAIR_GAIN = 0.05, 0.1
SCORE_MARGIN = 0.02  # below the best score; guesses within it are listed as alternatives (chosen)
STEPS_S = (("s", 0.5), ("ms", 500.0), ("us", 5e5))  # unit of time and upper limit of its step (chosen)


class _Guess(NamedTuple):
    """Candidate: a displacement with one or two commands."""

    score: float
    correlation: float
    commands: tuple[str, ...]
    displacement: str


class _Time(NamedTuple):
    """The time column, its unit and the reason; the name is None if every channel has a clock."""

    name: str | None
    unit: str
    reason: str


def propose(logs: str | Path | Iterable[str | Path]) -> str:
    """Return the text of a first `campaign.toml` for logs, every guess with its reason as a comment.

    Displacement and command are the two columns with the largest correlation of rate and mean over windows of
    all logs, with a bonus for names; two one-sided commands are combined.

    Args:
        logs: files and folders.

    Raises:
        InputError: there are no logs, none can be read, or no two columns correlate.
    """
    paths = find_logs(logs)
    # Spread over all, since neighbours by name are often of one direction.
    paths = [paths[index] for index in np.unique(np.linspace(0, len(paths) - 1, MAX_LOGS).astype(int))]
    settings = settings_of(paths)
    with ReaderProcess() as process:
        contents, unread = split_usable(
            [(path.name, path) for path in paths],
            lambda path: read_content(
                path,
                ChannelSelection("", None, tuple(map(Path, settings[path.parent].can.databases))),
                process,
            ),
            strict=False,
        )
    if not contents:
        refuse(unread, "logs")
    # If columns differ between logs, the most common set: others belong to another campaign.
    reference = max(contents, key=lambda log: sum(log.channels.keys() == c.channels.keys() for c in contents))
    contents = [log for log in contents if log.channels.keys() == reference.channels.keys()]
    time, as_read = _time(contents), contents
    contents = [_with_clocks(content, time) for content in contents]
    names = []
    for name in contents[0].channels:
        arrays = [content.channels[name].values for content in contents]
        is_constant = not any(samples.size > 0 and np.ptp(samples) > 0 for samples in arrays)
        if name != time.name and not is_constant and all(samples.size > 1 for samples in arrays):
            names.append(name)
    guesses = sorted(_guesses(windows(contents, names), contents), reverse=True) if names else []
    if not guesses:
        raise InputError(
            "no pair of columns correlates like command and displacement; "
            f"check the columns: {', '.join(names) or 'none'}"
        )
    # A line break in a name would end a comment.
    lines = [printable(line.replace("\n", " ")) for line in _lines(guesses, time, contents, names)]
    stops = _end_stops(tomllib.loads("\n".join(lines))["signals"], as_read)
    title = f"# Proposed by hitchid inspect --propose from {len(contents)} logs: check every line."
    return "\n".join([title, *stops, *lines])


def _time(contents: Sequence[Content]) -> _Time:
    """Return the column that increases in every log, preferably one named as a time."""
    longest = max((c.values.size for c in contents[0].channels.values()), default=0)
    first = {
        name: c
        for name, c in contents[0].channels.items()
        if c.clock_s is not None or c.values.size == longest
    }
    if all(channel.clock_s is not None for channel in first.values()):
        return _Time(None, "s", "")
    increasing = [
        name for name in first if all(_is_increasing(content.channels[name].values) for content in contents)
    ]
    increasing.sort(key=lambda name: not words(name) & TIME)
    if not increasing:
        raise InputError(
            f"{contents[0].source}: no column increases like a time; check the columns: {', '.join(first)}"
        )
    name = increasing[0]
    stamps = first[name].values[np.isfinite(first[name].values)]
    step = float(np.median(np.diff(stamps)))
    unit, reason = stated_unit(name, first[name].unit)
    is_date = any(low < stamps[0] < high for low, high in DATES_D) and step < LONGEST_DATE_STEP_D
    if is_date and unit in (None, "d"):
        unit, reason = "d", "dates as days, as spreadsheets and MATLAB count them"
    elif unit is None or UNITS[unit].dimension != "time":
        epoch = next((unit for unit, start in EPOCHS if start < stamps[0] < 3 * start), None)
        unit = epoch or next((unit for unit, limit in STEPS_S if step < limit), "ns")
        reason = "unit guessed from the step: check it"
    return _Time(name, unit, f"increases in every log, by {step:.4g} {unit} in the median; {reason}")


def _is_increasing(values: np.ndarray) -> bool:
    values = values[np.isfinite(values)]
    if values.size < 2 or not values[-1] > values[0]:
        return False
    # An event has a row of its own at the stamp of the row before.
    rising, falling = float(np.mean(np.diff(values) > 0)), float(np.mean(np.diff(values) < 0))
    return falling <= 1 - INCREASING_FRACTION and rising >= RISING_FRACTION


def _with_clocks(content: Content, time: _Time) -> Content:
    """Return a log whose channels hold the samples that are numbers, each with its time, s."""
    stamps = None if time.name is None else content.channels[time.name].values * UNITS[time.unit].factor
    channels = {}
    for name, channel in content.channels.items():
        clock = np.asarray(channel.clock_s) if stamps is None else stamps
        if clock.size != channel.values.size:  # no signal over time, such as a vector of parameters
            continue
        finite = np.isfinite(channel.values) & np.isfinite(clock)
        channels[name] = LogChannel(
            channel.values[finite], channel.unit, np.maximum.accumulate(clock[finite])
        )
    return replace(content, channels=channels)


def _guesses(log_windows: Windows, contents: Sequence[Content]) -> Iterator[_Guess]:
    """Yield every displacement with every candidate command, or pair of one-sided commands."""
    for y in (name for name in log_windows.means if _smooth(name, contents)):
        single = {c: log_windows.correlation([log_windows.means[c]], y) for c in log_windows.means if c != y}
        for c, correlation in single.items():
            yield _Guess(_score(correlation, (c,), y, contents), correlation, (c,), y)
        one_sided = [
            c for c, r in single.items() if abs(r) > MIN_PAIR_CORRELATION and _range(c, contents)[0] >= 0
        ]
        for plus, minus in permutations(one_sided, 2):
            if not single[plus] > 0 > single[minus]:
                continue
            correlation = log_windows.correlation([log_windows.means[plus], log_windows.means[minus]], y)
            unexplained = 1 - max(single[plus], -single[minus]) ** 2
            if 1 - correlation**2 < (1 - MIN_PAIR_GAIN) * unexplained:
                yield _Guess(_score(correlation, (plus, minus), y, contents), correlation, (plus, minus), y)


def _smooth(name: str, contents: Sequence[Content]) -> bool:
    """Return whether a channel's one-step changes are small compared with its range, as for a piston."""
    low, high = _range(name, contents)
    motion = sum(float(np.abs(np.diff(content.channels[name].values)).mean()) for content in contents)
    return motion < MAX_STEP_RATIO * len(contents) * (high - low)


def _score(correlation: float, commands: tuple[str, ...], y: str, contents: Sequence[Content]) -> float:
    """Return the magnitude of a correlation plus the bonuses and penalties of the names."""
    of_y, of_commands = words(y), [words(c) for c in commands]
    unit, _ = stated_unit(y, contents[0].channels[y].unit)
    position = bool(of_y & POSITION) or (unit and UNITS[unit].dimension in ("length", "angle"))
    return (
        abs(correlation)
        + 0.1 * all(name_words & COMMAND for name_words in of_commands)
        + 0.1 * bool(position)
        + 0.15 * any(name_words & AXIS for name_words in (of_y, *of_commands))
        - 0.2 * any(name_words & NO_COMMAND for name_words in (of_y, *of_commands))
        - 0.2 * bool(of_y & COMMAND or of_y & PRESSURE)
        + 0.001 * (correlation > 0)
    )


def _lines(
    guesses: Sequence[_Guess], time: _Time, contents: Sequence[Content], names: Sequence[str]
) -> Iterator[str]:
    best = guesses[0]
    yield "[signals]"
    if time.name is not None:
        yield f"# {time.reason}"
        yield f"time = {_column(time.name, time.unit)}"
    else:
        yield "# the file has a clock for every channel: no time column is needed"
    zero = _rest_reading(best, contents)
    commands = _roles(best, zero, _range(best.commands[0], contents))
    for role, name in (*commands, ("displacement", best.displacement)):
        low, high = _range(name, contents)
        unit, source = unit_of(role, name, contents[0].channels[name].unit, max(abs(low), abs(high)), zero)
        options = ""
        if role == "command" and zero is not None:
            options += f", zero = {zero:.6g}"
            yield f"# at rest {zero:.6g}, moves the displacement in both directions about this value"
        if role == "command" and best.correlation < 0:
            options += ", scale = -1"
            yield "# the displacement decreases while it is above its zero: the sign is reversed"
        yield f"# {low:.5g} to {high:.5g}, {_reason(role, best)}; {source}"
        yield f"{role} = {_column(name, unit, options)}"
    yield from _covariates(best, contents, names)
    for guess in guesses[1:4]:
        if guess.score > best.score - SCORE_MARGIN:
            yield f"# almost equally likely: {' and '.join(guess.commands)} with {guess.displacement}"
    yield ""


def _roles(best: _Guess, zero: float | None, limits: tuple[float, float]) -> list[tuple[str, str]]:
    """Return role and column of each command; a single one is signed if its range includes its zero."""
    if len(best.commands) == 2:
        lifting, lowering = best.commands
        if words(lifting) & DOWN and words(lowering) & UP:
            lifting, lowering = lowering, lifting
        return [("lifting_command", lifting), ("lowering_command", lowering)]
    (name,) = best.commands
    if zero is not None or limits[0] < 0 < limits[1]:
        return [("command", name)]
    name_words = words(name)
    named_up, named_down = bool(name_words & UP), bool(name_words & DOWN)
    lifts = named_up if named_up != named_down else best.correlation > 0
    return [("lifting_command" if lifts else "lowering_command", name)]


def _reason(role: str, best: _Guess) -> str:
    if role == "displacement":
        return f"smooth, its rate correlates with the command (r = {best.correlation:.2f})"
    if role == "command":
        return f"one signed column that moves {best.displacement} in both directions"
    direction = "up" if role == "lifting_command" else "down"
    other = "with the other command" if len(best.commands) == 2 else "alone"
    return (
        f"one-sided; {other}, it moves {best.displacement}; direction {direction} from "
        "its name or from the motion"
    )


def _end_stops(signals: Mapping[str, object], contents: Sequence[Content]) -> Iterator[str]:
    """Yield the line with the end stops at which the piston of logs stands under command, if any."""
    try:
        signal_map = signal_map_of(signals)
        records_by_log, _ = split_usable(
            [(str(content.source), content) for content in contents],
            lambda content: records_of(str(content.source), table_of(content, signal_map), signal_map),
            strict=False,
        )
        campaign = Campaign.of([record for records in records_by_log for record in records])
    except InputError:  # inspection gives the reason
        return
    with np.errstate(all="ignore"):  # as in an audit
        stops = [stop for stop in find_end_stops(campaign_context(campaign)).values() if stop.standing]
    if not stops:
        return
    unit, span = campaign.units[DISPLACEMENT], max(float(np.ptp(r.displacement)) for r in campaign.records)
    # To a thousandth of the range, which is nearer than noise allows.
    positions = sorted(round(stop.position, 3 - ceil(log10(span))) + 0.0 for stop in stops)
    places = " and ".join(f"{position:g}" for position in positions)
    yield f"# the piston stands at {places} {unit} although a command drives it on"
    if len(positions) == 2 and positions[0] < positions[1]:
        yield f"end_stops = [{positions[0]:g}, {positions[1]:g}]"
    else:
        yield "# an end stop; where the other is known, say both: end_stops = [lowest, highest]"


def _rest_reading(best: _Guess, contents: Sequence[Content]) -> float | None:
    """Return the neutral reading of a signed command; None if it is zero."""
    if len(best.commands) != 1:
        return None
    runs = []
    for content in contents:
        command, displacement = content.channels[best.commands[0]], content.channels[best.displacement]
        clock = np.asarray(displacement.clock_s)
        held = np.maximum(np.searchsorted(np.asarray(command.clock_s), clock, side="right") - 1, 0)
        step_s = float(np.median(np.diff(clock)))
        runs.append(CommandResponse(command.values[held], displacement.values, step_s))
    level, limits = rest_level(runs), _range(best.commands[0], contents)
    return level if level is not None and abs(level) > ACTIVE_FRACTION * max(map(abs, limits)) else None


def _covariates(best: _Guess, contents: Sequence[Content], names: Sequence[str]) -> Iterator[str]:
    """Yield lines on the pressure that probably measures the load, and on other pressures."""
    first = contents[0].channels
    units = {name: stated_unit(name, first[name].unit)[0] for name in names}
    pressures = [
        name
        for name in names
        if name not in (*best.commands, best.displacement)
        and (words(name) & PRESSURE or UNITS[units[name] or "1"].dimension == "pressure")
    ]
    pressures.sort(key=lambda name: (not words(name) & LOADED_SIDE, -np.ptp(_range(name, contents))))
    if pressures:
        also = f"; other pressures: {', '.join(pressures[1:MAX_SHOWN])}" if pressures[1:] else ""
        yield f"# a pressure by its name; may represent the load{also}"
        yield f"covariates = [{toml_text(pressures[0])}]"


def _range(name: str, contents: Sequence[Content]) -> tuple[float, float]:
    arrays = [content.channels[name].values for content in contents]
    return min(float(a.min()) for a in arrays), max(float(a.max()) for a in arrays)


def _column(name: str, unit: str, further: str = "") -> str:
    return f'{{ column = {toml_text(name)}, unit = "{unit}"{further} }}'
