"""From the tests of one direction to what both phases work on: direction, end stop, dead zone, validation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from hitchid.data.campaign import STROKE_MARK, Campaign
from hitchid.data.left_out import LeftOut, refuse, sentences, sift
from hitchid.data.record import CYCLE, LIFTING, MODES, Record
from hitchid.data.test_kinds import ACTIVE_FRACTION, end_stop_contact, mode_changes
from hitchid.errors import InputError, LogError
from hitchid.identification.deadzone import (
    DeadZone,
    from_tests,
    of_onsets,
    ramp_onset,
    ramp_rate,
    response_delay,
)
from hitchid.structures import Batch, before_end_stop

VALIDATION_EVERY = 4
VALIDATION_FRACTION = 0.25
STOP_AGREEMENT = 0.02
STRETCHED, SETTLING_S = 2.0, 2.0
Travelled = tuple[np.ndarray, np.ndarray, np.ndarray]
FEWEST_SAMPLES = 3


@dataclass(frozen=True)
class Prepared:
    """The identification tests of one direction.

    Attributes:
        mode: the direction.
        direction: +1 where the displacement grows with the command, −1 where it falls.
        end_stop: displacement the piston did not pass, None where no test met an end stop.
        dead_zone: dead zone of the command.
        everything: all identification tests, for phase 1.
        training, validation: those that train and those that stop the training, for phase 2.
        validation_names: names of the latter.
        notices: what the user should know.
        left_out: tests and ramps that cannot be used.
    """

    mode: str
    direction: int
    end_stop: float | None
    dead_zone: DeadZone
    everything: Batch
    training: Batch
    validation: Batch
    validation_names: tuple[str, ...]
    notices: tuple[str, ...]
    left_out: tuple[LeftOut, ...] = ()

    def behind(self, dead_zone: DeadZone) -> "Prepared":
        """Return the tests behind another dead zone."""
        if dead_zone == self.dead_zone:
            return self
        batches = (self.everything, self.training, self.validation)
        everything, training, validation = (batch.with_dead_zone(dead_zone.value) for batch in batches)
        return replace(
            self, dead_zone=dead_zone, everything=everything, training=training, validation=validation
        )


def prepare(
    campaign: Campaign, mode: str, dead_zone: DeadZone | None, *, load: str | None = None
) -> Prepared:
    """Prepare the identification tests of one direction.

    Left out are tests that lack the second input or are all at the end stop, and ramps that end before the
    piston moves; of a strict campaign the first of them is an error. What is held out stays so.

    Args:
        campaign: tests, of one direction each.
        mode: the direction.
        dead_zone: where it is known already; otherwise found from ramps, or else from the tests.
        load: name of a second measured input.

    Raises:
        InputError: every test of the direction is held out or left out.
    """
    records = campaign.identification(mode)
    if not records:
        raise InputError(
            f"all {len(campaign.of_kind(mode))} {mode} tests are held out; none is left to identify from"
        )
    strict, total = campaign.strict, len(records)
    records, lacking = sift(_by_name(records), lambda record: record.require(load), strict=strict)
    if not records:
        refuse(lacking, f"{mode} tests")
    direction = _direction(records, mode)
    end_stop, contacts = _end_stop(records, mode, direction)
    records, stopped = sift(
        _by_name(records), lambda record: _before_stop(record, direction, end_stop), strict=strict
    )
    if not records:
        refuse([*lacking, *stopped], f"{mode} tests")
    left_out = [*lacking, *stopped]
    records = _without_long_rests(records, mode)
    # Strokes of one log share its notices; `log#003` is a stroke of `log`.
    notices = list(
        dict.fromkeys(f"{r.name.partition(STROKE_MARK)[0]}: {said}" for r in records for said in r.notices)
    )
    notices += sentences(left_out, total, f"{mode} tests")
    if direction != _usual(mode):
        notices.append(
            f"the displacement {'grows' if direction > 0 else 'falls'} in {mode}: taken as measured"
        )
    if end_stop is not None:
        notices.append(
            f"end stop at {end_stop:.4g} {records[0].unit}, met in {contacts} of {total - len(lacking)} "
            "tests; samples at it are left out"
        )
    travelled = [_travelled(record, mode, direction, end_stop) for record in records]
    if dead_zone is None:
        dead_zone, unmoved = _of_ramps(campaign, mode, direction, travelled)
        notices += sentences(unmoved, len(campaign.ramps(mode)), f"{mode} ramps")
        left_out += unmoved
    if dead_zone is None:
        dead_zone = from_tests(travelled, campaign.step_s)
    if dead_zone.origin == "none":
        notices.append("the dead zone cannot be told from one level of command: taken as zero")
    everything = Batch.of(
        records, mode, dead_zone=dead_zone.value, direction=direction, end_stop=end_stop, load=load
    )
    training, validation, chosen = _divide(everything, len(records))
    if len(records) == 1:
        notices.append("one test only: its last quarter stops the training, so validation is not by test")
    return Prepared(
        mode=mode,
        direction=direction,
        end_stop=end_stop,
        dead_zone=dead_zone,
        everything=everything,
        training=training,
        validation=validation,
        validation_names=tuple(records[row].name for row in chosen),
        notices=tuple(notices),
        left_out=tuple(left_out),
    )


def mixed_dead_zones(campaign: Campaign) -> dict[str, DeadZone]:
    """Return a first dead zone of each direction, to cut the cycles of a campaign that has nothing else.

    Every stretch with a command of one direction counts as a test. Held-out cycles are not looked at.
    """
    cycles = campaign.identification(CYCLE)
    found = {}
    for mode in MODES:
        of_ramps, _ = _of_ramps(campaign, mode, _usual(mode), [])
        if of_ramps is not None:
            found[mode] = of_ramps
            continue
        stretches = [
            record.slice(stroke.start, stroke.stop)
            for record in cycles
            for stroke in mode_changes(record, {})
            if stroke.mode == mode and mode in record.modes and stroke.stop - stroke.start > 1
        ]
        if stretches:
            direction = _direction(stretches, mode)
            found[mode] = from_tests(
                [_travelled(r, mode, direction, None) for r in stretches], campaign.step_s
            )
    return found


def _without_long_rests(records: Sequence[Record], mode: str) -> list[Record]:
    """Return strokes cut from mixed logs with none much longer for the rest at its end.

    All tests of a direction are computed at the length of the longest. Where a stroke is more than twice as
    long as the median one, what it rests beyond that is cut off, but not the first 2 s after its command.
    """
    longest = STRETCHED * float(np.median([len(record) for record in records]))

    def cut(record: Record) -> Record:
        if STROKE_MARK not in record.name or len(record) <= longest:
            return record
        command = np.abs(record.command(mode))
        active = np.flatnonzero(command > ACTIVE_FRACTION * command.max())
        moving = int(active[-1]) + 1 if active.size else 0
        return record.slice(0, max(round(longest), moving + round(SETTLING_S / record.step_s)))

    return [cut(record) for record in records]


def _by_name(records: Sequence[Record]) -> list[tuple[str, Record]]:
    return [(record.name, record) for record in records]


def _before_stop(record: Record, direction: int, end_stop: float | None) -> Record:
    """Return a record unless all of it is at the end stop."""
    if len(record) < FEWEST_SAMPLES:
        raise LogError(
            record.source or record.name,
            f"the stroke has {len(record)} samples; required {FEWEST_SAMPLES} or more",
        )
    if np.count_nonzero(before_end_stop(record.displacement, direction, end_stop)) < FEWEST_SAMPLES:
        raise LogError(
            record.source or record.name,
            f"the piston is at its end stop of {end_stop:.4g} {record.unit} from the start; "
            "required a test that begins away from it",
        )
    return record


def _of_ramps(
    campaign: Campaign, mode: str, direction: int, travelled: Sequence[Travelled]
) -> tuple[DeadZone | None, list[LeftOut]]:
    """Return the dead zone from the ramps that move the piston, None without any, and the other ramps.

    A ramp shows motion late by the plant's delay, in which its command rises on: the tests tell that delay.
    """
    ramps, unmoved = sift(
        _by_name(campaign.ramps(mode)),
        lambda ramp: (ramp_onset(ramp, mode, direction), ramp_rate(ramp, mode)),
        strict=campaign.strict,
    )
    if not ramps:
        return None, unmoved
    onsets, rates = zip(*ramps, strict=True)
    delay_s = response_delay(travelled, float(np.mean(onsets)), campaign.step_s) if travelled else 0.0
    return of_onsets(onsets, delay_s * float(np.mean(rates))), unmoved


def _usual(mode: str) -> int:
    return 1 if mode == LIFTING else -1


def _travelled(record: Record, mode: str, direction: int, end_stop: float | None) -> Travelled:
    """Return command, travel, and which samples come before the end stop is met."""
    travel = direction * (record.displacement - record.displacement[0])
    return record.command(mode), travel, before_end_stop(record.displacement, direction, end_stop)


def _direction(records: Sequence[Record], mode: str) -> int:
    """Return the sign with which displacement follows the integral of the command."""
    together = sum(
        float(np.dot(record.displacement - record.displacement[0], np.cumsum(record.command(mode))))
        for record in records
    )
    return 1 if together >= 0 else -1


def _end_stop(records: Sequence[Record], mode: str, direction: int) -> tuple[float | None, int]:
    """Return the displacement at which tests come to stand under command, and in how many they do.

    An end stop is one place, and the farthest: at least two tests must stand within 2 % of the range of all
    displacements of their median, and none may go farther beyond it.
    """
    contacts = [(record, end_stop_contact(record, mode)) for record in records]
    levels = np.array([np.median(record.displacement[at:]) for record, at in contacts if at is not None])
    if levels.size < 2:
        return None, 0
    farthest = max(float(np.max(direction * record.displacement)) for record in records)
    nearest = min(float(np.min(direction * record.displacement)) for record in records)
    near = STOP_AGREEMENT * (farthest - nearest)
    level = float(np.median(levels))
    agreeing = int(np.sum(np.abs(levels - level) <= near))
    at_the_end = farthest - direction * level <= near
    return (level, agreeing) if agreeing >= 2 and at_the_end else (None, 0)


def _divide(batch: Batch, tests: int) -> tuple[Batch, Batch, list[int]]:
    """Return training and validation tests: every fourth, of few the last, of one its last quarter."""
    if tests == 1:
        ends = jnp.cumsum(batch.counted, axis=1)
        early = ends <= (1 - VALIDATION_FRACTION) * ends[:, -1:]
        return batch.counting(early), batch.counting(~early), [0]
    chosen = list(range(VALIDATION_EVERY - 1, tests, VALIDATION_EVERY)) or [tests - 1]
    rest = [row for row in range(tests) if row not in chosen]
    return batch.take(rest), batch.take(chosen), chosen
