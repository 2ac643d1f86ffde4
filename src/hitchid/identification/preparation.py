"""Preparation of the tests of one direction: sign, end stop, dead zone, validation tests."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hitchid.errors import InputError, LogError
from hitchid.identification.dead_zone import (
    DeadZone,
    from_onsets,
    from_tests,
    ramp_onset,
    ramp_rate,
    response_delay,
    with_dynamics,
)
from hitchid.logs.audit import find_end_stop, update_interval
from hitchid.logs.audit.context import quality
from hitchid.logs.campaign import STROKE_SEPARATOR, Campaign
from hitchid.logs.kinds import ACTIVE_FRACTION, split_by_direction
from hitchid.logs.record import CYCLE, DIRECTIONS, LIFTING, Record
from hitchid.logs.unification import LeftOut, left_out_notices, refuse, split_usable
from hitchid.model import Channel
from hitchid.networks.operating_range import OperatingRange
from hitchid.structures import Batch, PhysicalModel, before_end_stop, split_validation

MAX_LENGTH_RATIO, SETTLING_S = 2.0, 2.0  # of the median stroke; s of rest that are kept: lags have died away
TestSignals = tuple[np.ndarray, np.ndarray, np.ndarray]
FEWEST_SAMPLES = 3  # of a test: displacement, speed and one residual


@dataclass(frozen=True)
class ChannelData:
    """The identification tests of one direction.

    Attributes:
        direction: the direction.
        sign: +1 where the displacement grows with the command, −1 where it falls.
        end_stop: displacement the piston does not pass, None where it is not given and no test met it.
        dead_zone: dead zone of the command.
        all_tests: all identification tests, for phase 1.
        names: their names.
        training, validation: those that train and those that stop the training, for phase 2.
        validation_names: names of the latter.
        notices: sentences for the user.
        left_out: tests and ramps that cannot be used.
        update_s: interval at which the sensor is updated, s; zero where each sample is measured anew.
    """

    direction: str
    sign: int
    end_stop: float | None
    dead_zone: DeadZone
    all_tests: Batch
    names: tuple[str, ...]
    training: Batch
    validation: Batch
    validation_names: tuple[str, ...]
    notices: tuple[str, ...]
    left_out: tuple[LeftOut, ...] = ()
    update_s: float = 0.0

    def channel(self, benchmark: PhysicalModel, operating_range: OperatingRange) -> Channel:
        """Return a channel with a benchmark and no compensators."""
        dead_zone, stop = self.dead_zone.value, self.end_stop
        return Channel(self.direction, self.sign, dead_zone, stop, benchmark, operating_range=operating_range)

    def with_dead_zone(self, dead_zone: DeadZone) -> "ChannelData":
        """Return the tests behind another dead zone."""
        if dead_zone == self.dead_zone:
            return self
        batches = (self.all_tests, self.training, self.validation)
        all_tests, training, validation = (batch.with_dead_zone(dead_zone.value) for batch in batches)
        return replace(
            self, dead_zone=dead_zone, all_tests=all_tests, training=training, validation=validation
        )


def prepare(
    campaign: Campaign,
    direction: str,
    dead_zone: DeadZone | None,
    *,
    covariates: Sequence[str] = (),
    cycles: Sequence[Record] = (),
) -> ChannelData:
    """Prepare the identification tests of one direction.

    Left out are tests that lack a covariate or are all at the end stop, and ramps that end before the
    piston moves; of a strict campaign the first of them is an error. What is held out stays so. Where it is
    not known already, the dead zone is found from ramps, or else from the tests. End stops are looked for in
    the mixed logs that the tests are strokes of.

    Raises:
        InputError: every test of the direction is held out or left out.
    """
    records, sign, end_stop, left_out, notices = _usable_tests(campaign, direction, covariates, cycles)
    updates = [update_interval(record, quality(record)) for record in cycles or records]
    update_s = max((interval for interval in updates if interval is not None), default=0.0)
    if update_s:
        notices.append(
            f"the displacement is updated every {update_s:.3g} s but logged every {campaign.step_s:.3g} s: "
            "delays are known no better than that"
        )
    signals = [_test_signals(record, direction, sign, end_stop) for record in records]
    if dead_zone is None:
        dead_zone, unmoved_ramps = _dead_zone_from_ramps(campaign, direction, sign, signals)
        ramps = len(campaign.ramps(direction))
        notices += map(str, left_out_notices(unmoved_ramps, ramps, f"{direction} ramps"))
        left_out += unmoved_ramps
    if dead_zone is None:
        dead_zone = from_tests(signals, campaign.step_s)
    if dead_zone.origin == "none":
        notices.append("the dead zone cannot be identified from one level of command; zero is used")

    def behind(dead_zone: DeadZone) -> Batch:
        """Return the tests behind a dead zone."""
        return Batch.of(
            records, direction, dead_zone=dead_zone.value, sign=sign, end_stop=end_stop, covariates=covariates
        )

    dead_zone = with_dynamics(dead_zone, behind(dead_zone))
    all_tests = behind(dead_zone)
    training, validation, validation_rows = split_validation(all_tests)
    if len(records) == 1:
        notices.append("only one test: its last quarter is used for early stopping")
    return ChannelData(
        direction=direction,
        sign=sign,
        end_stop=end_stop,
        dead_zone=dead_zone,
        all_tests=all_tests,
        names=tuple(record.name for record in records),
        training=training,
        validation=validation,
        validation_names=tuple(records[row].name for row in validation_rows),
        notices=tuple(notices),
        left_out=tuple(left_out),
        update_s=update_s,
    )


class _UsableTests(NamedTuple):
    """Tests of one direction that can be used, which way and how far the piston goes, and what is said."""

    records: list[Record]
    sign: int
    end_stop: float | None
    left_out: list[LeftOut]
    notices: list[str]


def _usable_tests(
    campaign: Campaign, direction: str, covariates: Sequence[str], cycles: Sequence[Record]
) -> _UsableTests:
    records = campaign.identification(direction)
    if not records:
        raise InputError(
            f"all {len(campaign.of_kind(direction))} {direction} tests are held out; "
            "name at least one for identification under [split]"
        )
    strict, total = campaign.strict, len(records)
    records, without_covariate = split_usable(
        _by_name(records), lambda record: record.require(covariates), strict=strict
    )
    if not records:
        refuse(without_covariate, f"{direction} tests")
    sign = _direction(records, direction)
    known = campaign.end_stop(sign)
    # Before the tests at it are left out: they are those that show where it is.
    stop = find_end_stop(cycles or records, direction, sign, known)
    end_stop = known if stop is None else stop.position
    records, at_end_stop = split_usable(
        _by_name(records), lambda record: _check_before_end_stop(record, sign, end_stop), strict=strict
    )
    left_out = [*without_covariate, *at_end_stop]
    if not records:
        refuse(left_out, f"{direction} tests")
    records = _without_long_rests(records, direction)
    # Strokes of one log share its notices; `log#003` is a stroke of `log`.
    logs = [(record.name.partition(STROKE_SEPARATOR)[0], record.notices) for record in records]
    log_notices = dict.fromkeys(f"{name}: {notice}" for name, texts in logs for notice in texts)
    notices = [*log_notices, *map(str, left_out_notices(left_out, total, f"{direction} tests"))]
    if sign != _expected_sign(direction):
        notices.append(
            f"the displacement {'increases' if sign > 0 else 'decreases'} in {direction}; "
            "the direction is identified as measured"
        )
    if end_stop is not None:
        reached = () if stop is None else stop.reached
        names = f" ({', '.join(reached)})" if reached else ""
        searched = f"{len(cycles)} logs" if cycles else f"{total - len(without_covariate)} tests"
        notices.append(
            f"end stop at {end_stop:.4g} {records[0].unit}{', as given' if known is not None else ''}, "
            f"reached in {len(reached)} of {searched}{names}; samples at it are left out"
        )
    return _UsableTests(records, sign, end_stop, left_out, notices)


def mixed_dead_zones(campaign: Campaign) -> dict[str, DeadZone]:
    """Return a first dead zone of each direction, to cut the cycles of a campaign that has nothing else.

    Every stretch with a command of one direction counts as a test. Held-out cycles are not used.
    """
    cycles = campaign.identification(CYCLE)
    dead_zones = {}
    for direction in DIRECTIONS:
        dead_zone, _ = _dead_zone_from_ramps(campaign, direction, _expected_sign(direction), [])
        if dead_zone is not None:
            dead_zones[direction] = dead_zone
            continue
        stretches = [
            record.slice(stroke.start, stroke.stop)
            for record in cycles
            for stroke in split_by_direction(record, {})
            if stroke.direction == direction
            and direction in record.directions
            and stroke.stop - stroke.start > 1
        ]
        if stretches:
            sign = _direction(stretches, direction)
            dead_zones[direction] = from_tests(
                [_test_signals(stretch, direction, sign, None) for stretch in stretches], campaign.step_s
            )
    return dead_zones


def _without_long_rests(records: Sequence[Record], direction: str) -> list[Record]:
    """Return strokes cut from mixed logs with none much longer for the rest at its end.

    All tests of a direction are computed at the length of the longest. Where a stroke is more than twice as
    long as the median one, what it rests beyond that is cut off, but not the first 2 s after its command.
    """
    longest = MAX_LENGTH_RATIO * float(np.median([len(record) for record in records]))

    def cut(record: Record) -> Record:
        if STROKE_SEPARATOR not in record.name or len(record) <= longest:
            return record
        command = np.abs(record.command(direction))
        active = np.flatnonzero(command > ACTIVE_FRACTION * command.max())
        active_end = int(active[-1]) + 1 if active.size else 0
        return record.slice(0, max(round(longest), active_end + round(SETTLING_S / record.step_s)))

    return [cut(record) for record in records]


def _by_name(records: Sequence[Record]) -> list[tuple[str, Record]]:
    return [(record.name, record) for record in records]


def _check_before_end_stop(record: Record, sign: int, end_stop: float | None) -> Record:
    """Return a record unless all of it is at the end stop."""
    source = record.source or record.name
    if len(record) < FEWEST_SAMPLES:
        raise LogError(source, f"the stroke has {len(record)} samples; expected {FEWEST_SAMPLES} or more")
    if np.count_nonzero(before_end_stop(record.displacement, sign, end_stop)) < FEWEST_SAMPLES:
        raise LogError(
            source,
            f"the piston is at its end stop of {end_stop:.4g} {record.unit} from the start; "
            "expected a test that starts before the end stop",
        )
    return record


def _dead_zone_from_ramps(
    campaign: Campaign, direction: str, sign: int, signals: Sequence[TestSignals]
) -> tuple[DeadZone | None, list[LeftOut]]:
    """Return the dead zone from the ramps that move the piston, None without any, and the other ramps.

    A ramp shows motion late by the plant's delay, in which its command rises on: the tests give that delay.
    """
    ramps, unmoved_ramps = split_usable(
        _by_name(campaign.ramps(direction)),
        lambda ramp: (ramp_onset(ramp, direction, sign), ramp_rate(ramp, direction)),
        strict=campaign.strict,
    )
    if not ramps:
        return None, unmoved_ramps
    onsets, rates = zip(*ramps, strict=True)
    delay_s = response_delay(signals, float(np.mean(onsets)), campaign.step_s) if signals else 0.0
    return from_onsets(onsets, delay_s * float(np.mean(rates))), unmoved_ramps


def _expected_sign(direction: str) -> int:
    return 1 if direction == LIFTING else -1


def _test_signals(record: Record, direction: str, sign: int, end_stop: float | None) -> TestSignals:
    """Return command, travel, and which samples come before the end stop is met."""
    travel = sign * (record.displacement - record.displacement[0])
    return record.command(direction), travel, before_end_stop(record.displacement, sign, end_stop)


def _direction(records: Sequence[Record], direction: str) -> int:
    """Return the sign with which displacement follows the integral of the command."""
    correlation = sum(
        float(np.dot(record.displacement - record.displacement[0], np.cumsum(record.command(direction))))
        for record in records
    )
    return 1 if correlation >= 0 else -1
