"""Whether command, current and displacement were logged on one clock."""

import numpy as np

from hitchid.audit.finding import AuditFinding, Level
from hitchid.audit.look import Look, Survey, travel
from hitchid.data.record import COMMAND, DISPLACEMENT, RAMP
from hitchid.data.units import UNITS

LONGEST_LAG_S = 1.0
MOST_LAGS = 2000
LOOKED_AT = 2**18
LEAST_CORRELATION = 0.7
LEAST_SHARPNESS = 0.02
LEAD_SAMPLES = 1.0
LATE_S = 0.1
CHANGED_FRACTION = 0.01
WORTH_FRACTION = 0.005
FEWEST_BEFORE = 5
CREEP_FRACTION = 0.3


def leading_current(look: Look) -> list[AuditFinding]:
    """Tell by how much each measured current lags behind its command.

    The lag is where the correlation of command and current is largest within ±1 s, between samples by a
    parabola through the three largest. The command is that of the mode, or the sum of both, which fits best.
    It counts if the correlation reaches 0.7 and falls by 0.02 towards both ends (a slow ramp's does not). A
    current that leads by more than one sample, which the order of logging explains, is a fault: no coil is
    ahead of its command. A lag above 0.1 s is a warning, for coils take a tenth of that; any other a note.
    """
    record = look.record
    found = []
    for role, unit in record.units.items():
        known = role in COMMAND.values() or role == DISPLACEMENT or role not in record.signals
        if known or UNITS[unit].dimension != "current" or record.kind == RAMP:
            continue
        choices = {f"the {mode} command": (mode,) for mode in record.modes} | {"the commands": record.modes}
        lags = [(fit[1], fit[0], name) for name, of in choices.items() if (fit := _fit(look, of, role))]
        if not lags:
            continue
        _, lag, name = max(lags)
        lead = -lag > LEAD_SAMPLES * record.step_s
        late = lag > max(LATE_S, LEAD_SAMPLES * record.step_s)
        level = Level.FAULT if lead else Level.WARNING if late else Level.NOTE
        way = f"leads {name} by" if lag < 0 else f"lags behind {name} by"
        advice = {
            Level.FAULT: "command and current are on different clocks: log both with one device",
            Level.WARNING: "check the filter of the current and the clocks; the model takes it for dead time",
            Level.NOTE: "nothing to do: the model takes this into its dead time and lag",
        }[level]
        found.append(look.finding("lag", level, f"{role} {way} {abs(lag):.4f} s", advice, signal=role))
    return found


def _fit(look: Look, modes: tuple[str, ...], role: str) -> tuple[float, float] | None:
    """Return lag, s, and correlation of a current and the sum of commands, or None if none can be told."""
    active = look.any_active()
    if not active.any():
        return None
    most = round(min(LONGEST_LAG_S / look.record.step_s, MOST_LAGS))
    first = max(0, int(np.argmax(active)) - 2 * most)
    piece = slice(first, first + LOOKED_AT)
    return lag_of(
        np.sum([np.abs(look.record.command(mode)[piece]) for mode in modes], axis=0),
        look.record.signals[role][piece],
        step_s=look.record.step_s,
    )


def lag_of(command: np.ndarray, current: np.ndarray, *, step_s: float) -> tuple[float, float] | None:
    """Return by how much a current lags behind a command.

    Args:
        command, current: shape [N].
        step_s: sampling time, s.

    Returns:
        The lag, s, negative where the current leads, and the correlation at it; None where it is not sharp.
    """
    most = round(min(LONGEST_LAG_S / step_s, MOST_LAGS, command.size // 4))
    if most < 2:
        return None
    lags = np.arange(-most, most + 1)
    with np.errstate(all="ignore"):
        fit = _correlations(command, current, lags)
    if not np.all(np.isfinite(fit)):
        return None
    place = int(np.argmax(fit))
    top = float(fit[place])
    if not 0 < place < fit.size - 1 or top < LEAST_CORRELATION:
        return None
    if top - float(max(fit[0], fit[-1])) < LEAST_SHARPNESS:
        return None
    before, after = float(fit[place - 1]), float(fit[place + 1])
    bend = before - 2 * top + after
    between = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return float(lags[place] + between) * step_s, top


def _correlations(command: np.ndarray, current: np.ndarray, lags: np.ndarray) -> np.ndarray:
    """Return the correlation of c[k] and m[k + l], each over what overlaps, for lags l, shape [L]."""
    count = command.size
    # Of unit size, so that what has no spread beyond rounding is told from what has.
    a = (command - command.mean()) / np.max(np.abs(command - command.mean()))
    b = (current - current.mean()) / np.max(np.abs(current - current.mean()))
    length = 1 << int(count + lags.size).bit_length()
    both = np.conj(np.fft.rfft(a, length)) * np.fft.rfft(b, length)
    product = np.fft.irfft(both, length)[lags]
    early, late = np.maximum(-lags, 0), np.maximum(lags, 0)

    def sums(values: np.ndarray, first: np.ndarray, left: np.ndarray) -> np.ndarray:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return total[count - left] - total[first]

    overlap = count - np.abs(lags)
    mean_a, mean_b = sums(a, early, late) / overlap, sums(b, late, early) / overlap
    spread_a = sums(a * a, early, late) / overlap - mean_a * mean_a
    spread_b = sums(b * b, late, early) / overlap - mean_b * mean_b
    return (product / overlap - mean_a * mean_b) / np.sqrt(spread_a * spread_b)


def motion_first(survey: Survey) -> list[AuditFinding]:
    """Find tests in which the piston moves before any command changes.

    By more than 6 σ + 2 q and 0.5 % of the campaign's range, before a command first changes by 1 % of full
    scale. At less than 30 % of the speed the record has in its commanded part it creeps: a warning. At
    working speed it is a fault, for clocks don't agree, if at least two tests and half of those that begin at
    rest show it; else a warning. Parts after a gap begin in mid-motion and are left out.
    """
    looks = [look for look in survey.looks if look.record.name.rpartition("@")[2] in ("1", look.record.name)]
    onsets = [(look, _onset(look)) for look in looks]
    able = [(look, onset) for look, onset in onsets if onset is not None and onset >= FEWEST_BEFORE]
    early = [(look, onset, begun) for look, onset in able if (begun := _begun(look, onset)) is not None]
    running = [each for each in early if not _creeps(*each)]
    wrong = len(running) >= 2 and 2 * len(running) >= len(able)
    found = []
    for look, onset, begun in early:
        creeping = _creeps(look, onset, begun)
        moved = float(look.record.displacement[onset] - look.record.displacement[0])
        ahead = (onset - begun) * look.record.step_s
        found.append(
            look.finding(
                "motion before command",
                Level.FAULT if wrong and not creeping else Level.WARNING,
                f"the displacement {'creeps' if creeping else 'moves'} by {moved:.3g} {look.quality.unit} "
                f"before any command changes, beginning {ahead:.3g} s ahead",
                "let the piston come to rest before a test"
                if creeping
                else "check that command and displacement are logged on one clock, or begin tests at rest",
                at=[(begun, onset + 1)],
            )
        )
    return found


def _onset(look: Look) -> int | None:
    """Return the sample at which a command, zero at first, changes; None where none does."""
    record, firsts = look.record, []
    for mode in record.modes:
        command = record.command(mode)
        changed = np.abs(command - command[0]) > CHANGED_FRACTION * look.scales[mode]
        if look.active(mode)[0]:
            return None
        if changed.any():
            firsts.append(int(np.argmax(changed)))
    return min(firsts, default=None)


def _begun(look: Look, onset: int) -> int | None:
    """Return the sample at which the displacement has clearly left its start before the onset, or None."""
    displacement = look.record.displacement[:onset]
    rest = float(np.median(displacement[:FEWEST_BEFORE]))
    clear = max(look.quality.sure, WORTH_FRACTION * look.reach)
    off = np.abs(displacement - rest) > clear
    # A spike is off for a moment; motion still is when the command comes.
    return int(np.argmax(off)) if off[-1] and off[-2] else None


def _creeps(look: Look, onset: int, begun: int) -> bool:
    displacement = look.record.displacement
    window = max(1, min(onset, onset - begun + FEWEST_BEFORE))
    before = abs(float(displacement[onset] - displacement[onset - window])) / window
    # The travel, not all that moves, which noise would make more of.
    gone = sum(abs(travel(look, mode)) for mode in look.record.modes)
    working = gone / max(1, int(np.count_nonzero(look.any_active())))
    return bool(before < CREEP_FRACTION * working)
