"""Identification of one campaign: prepared tests, and assembly of the model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hitchid._support.jax_setup import installed_versions
from hitchid._support.precision import parallel
from hitchid._support.progress import ProgressCallback, attempt, parallel_progress
from hitchid.errors import InputError, SettingsError
from hitchid.identification.config import ChannelConfig, IdentificationConfig
from hitchid.identification.dead_zone import DeadZone
from hitchid.identification.direction import with_calibrated_gain
from hitchid.identification.hold_drift import drift_is_shown, hold_drift, holds
from hitchid.identification.mode_test import calibrate_gains, calibration_improves, compare_modes
from hitchid.identification.phase2 import CompensatorConfig
from hitchid.identification.preparation import ChannelData, mixed_dead_zones, prepare
from hitchid.identification.result import ChannelTrace, Identification
from hitchid.identification.rivals import trained_rivals
from hitchid.logs.audit import feedback_of
from hitchid.logs.campaign import Campaign
from hitchid.logs.from_rest import from_rest
from hitchid.logs.record import COMMAND, CYCLE, DISPLACEMENT, Record
from hitchid.model import Channel, Hitch, Provenance, Rivals, TravelLimits
from hitchid.structures import ModelSpec

# Test of the compensators for free run on whole cycles, where each continues where the other one ended.


def without_speed_compensators(hitch: Hitch) -> Hitch:
    """Return a hitch whose free runs are those of the benchmarks."""
    channels = {
        direction: replace(channel, speed_compensator=None) for direction, channel in hitch.channels.items()
    }
    return replace(hitch, channels=channels)


def cycle_errors(hitch: Hitch, cycles: Sequence[Record]) -> tuple[float, float]:
    """Return the free-run RMSE over whole cycles of a hitch, and of it without compensators for free run.

    Each cycle has the same weight; in the displacement's unit.
    """

    def rmse(hitch: Hitch) -> float:
        squares = [np.mean((hitch.simulate(each).displacement - each.displacement) ** 2) for each in cycles]
        return float(np.sqrt(np.mean(squares)))

    return rmse(hitch), rmse(without_speed_compensators(hitch))


ChannelResults = Mapping[str, tuple[Channel, ChannelTrace]]


@dataclass(frozen=True)
class CampaignJob:
    """A campaign prepared for identification.

    Where no test is of one direction, its tests are strokes cut from the mixed logs `cycles` at the dead
    zones of the segmentation. Fingerprints are those of all records that are used.
    """

    campaign: Campaign
    config: IdentificationConfig
    cycles: tuple[Record, ...]
    segmentation_dead_zones: Mapping[str, float]
    fingerprints: frozenset[str]
    channel_data: Mapping[str, ChannelData]
    channel_configs: Mapping[str, ChannelConfig]

    @classmethod
    def of(cls, campaign: Campaign, config: IdentificationConfig, folder: Path | None) -> "CampaignJob":
        """Prepare a campaign; raises InputError as `identify` does."""
        config = config.with_campaign_covariates(campaign)
        checkpoints = config.checkpoints(folder, campaign)
        if campaign.unmatched:
            pattern = campaign.unmatched[0]
            raise InputError(
                f"split.test: the pattern '{pattern}' matches none of the {len(campaign.records)} tests"
            )
        recorded, wrong = campaign, "gain and lag may be wrong by more than their intervals"
        campaign, in_motion = from_rest(campaign, otherwise=wrong)
        for direction, value in config.dead_zones.items():
            _check_dead_zone(campaign, direction, value)
        for direction, spec in config.specs.items():
            _check_covariates(campaign, direction, spec.covariate_names)
        # A structure that takes the raw command has the dead zone in its own equations.
        dead_zones = {
            direction: DeadZone(0.0, None, 0, "structure")
            for direction, spec in config.specs.items()
            if isinstance(spec, ModelSpec) and spec.structure.uses_raw_command
        }
        dead_zones |= {
            direction: DeadZone(value, None, 0, "given") for direction, value in config.dead_zones.items()
        }
        segmentation_dead_zones: dict[str, float] = {}
        cycles: tuple[Record, ...] = ()
        fingerprints = _fingerprints(campaign, campaign.directions, recorded)
        if not campaign.directions:
            segmentation_dead_zones = {
                direction: dead_zone.value
                for direction, dead_zone in {**mixed_dead_zones(campaign), **dead_zones}.items()
            }
            cycles = campaign.identification(CYCLE)
            # Of the logs and of their strokes: a model must know either where it is validated on them.
            fingerprints |= _fingerprints(campaign, (CYCLE,), recorded)
            campaign = campaign.segmented(segmentation_dead_zones)
            fingerprints |= _fingerprints(campaign, campaign.directions, recorded)
        if not campaign.directions:
            raise InputError(
                "no log contains lifting or lowering motion that can be identified; measure "
                "tests with commands well above the dead zone, and check the units of the "
                "signals"
            )
        channel_data, channel_configs = {}, {}
        for m in campaign.directions:
            names = config.specs[m].covariate_names
            data = prepare(campaign, m, dead_zones.get(m), covariates=names, cycles=cycles)
            channel_data[m] = replace(data, notices=(*in_motion, *data.notices))
            channel_configs[m] = config.channel(m, campaign, checkpoints)
        # Now, not after the hours of phase 1.
        _check_window(config.training, channel_data)
        seen = frozenset(fingerprints)
        return cls(campaign, config, cycles, segmentation_dead_zones, seen, channel_data, channel_configs)

    def calibrate_gains(self, results: ChannelResults) -> ChannelResults:
        """Return the channels with gains calibrated on whole mixed logs.

        Gains change only where strokes were cut from mixed logs and logs held out in turn prove them better.
        """
        if len(results) < 2 or not self.segmentation_dead_zones:
            return results
        notices: list[str] = []
        hitch, logs = self._hitch(results), self.cycles
        factors = attempt(
            "gain calibration",
            lambda: calibrate_gains(hitch, logs) if calibration_improves(hitch, logs) else {},
            notices,
        )
        if factors is None:
            return _with_notices(results, notices)
        scaled = {name: with_calibrated_gain(*results[name], factor) for name, factor in factors.items()}
        return {**results, **scaled}

    def judge_on_cycles(self, results: ChannelResults) -> ChannelResults:
        """Return the channels without the compensators for free run where these make whole cycles worse.

        Mixed logs beside tests of one direction decide nothing: they are what the model is validated on.
        """
        compensated = any(channel.speed_compensator is not None for channel, _ in results.values())
        if not compensated or not self.cycles:
            return results
        rmse, plain_rmse = cycle_errors(self._hitch(results), self.cycles)
        if rmse <= plain_rmse:
            return results
        unit = self.campaign.units[DISPLACEMENT]
        sentence = (
            "no network correction in free run: over whole cycles the error is "
            f"{rmse:.4g} {unit} with it, {plain_rmse:.4g} {unit} without it"
        )
        plain = dict(results)
        for direction, (channel, trace) in results.items():
            if channel.speed_compensator is not None:
                # Its bands know the errors with the correction: around free runs without it, too narrow.
                uncertainty = trace.uncertainty and replace(trace.uncertainty, bands=None)
                notices = (*trace.notices, f"{sentence}; no bands, for they were calibrated with it")
                trace = replace(trace, uncertainty=uncertainty, notices=notices)
                plain[direction] = replace(channel, speed_compensator=None), trace
        return plain

    def with_rivals(self, model: Hitch, progress: ProgressCallback) -> Hitch:
        """Return a model of this campaign with all rivals, trained to the tests of its channels."""
        training = self.config.training or CompensatorConfig()
        parts = parallel_progress(progress, tuple(model.channels))

        def train(direction: str) -> Rivals:
            initial_data, channel = self.channel_data[direction], model.channels[direction]
            data = initial_data.with_dead_zone(replace(initial_data.dead_zone, value=channel.dead_zone))
            config, searches = self.channel_configs[direction], self.config.rivals.searches
            rivals = trained_rivals(data, initial_data, config, training, searches, parts[direction])
            return rivals.with_limits(channel.limits)

        return replace(model, rivals=parallel(train, model.channels))

    def build_model(self, results: ChannelResults) -> Identification:
        """Assemble the model from its channels, with provenance, uncertainty and rivals."""
        # Last of all: only whole cycles show what compensators do where one stroke continues the other.
        results = self.judge_on_cycles(results)
        evidence = feedback_of(self._records())
        notices = [] if evidence is None else [evidence.sentence]
        mode_test = None
        if len({self.campaign.units[COMMAND[direction]] for direction in results}) == 1:
            mode_test = attempt("test of one shared model", lambda: compare_modes(self.channel_data), notices)
        drift = self._hitch(results).drift
        if drift:
            unit = self.campaign.units[DISPLACEMENT]
            notices.append(
                f"a held piston moves by {drift:.3g} {unit}/s, which free runs of mixed logs contain"
            )
        identification = self.assemble(_with_notices(results, notices))
        return replace(identification, model=replace(identification.model, two_modes=mode_test))

    def assemble(self, results: ChannelResults) -> Identification:
        """Return channels as a model, whether they have compensators yet or not."""
        campaign, traces = self.campaign, {direction: trace for direction, (_, trace) in results.items()}
        used = {}
        for direction in results:
            left_out = {test.name for test in self.channel_data[direction].left_out}
            names = (record.name for record in campaign.identification(direction))
            used[direction] = tuple(name for name in names if name not in left_out)
        provenance = Provenance(
            identification=used,
            validation={direction: self.channel_data[direction].validation_names for direction in results},
            held_out={
                direction: tuple(record.name for record in campaign.held_out(direction))
                for direction in results
            },
            seen=self.fingerprints,
            segmentation_dead_zones=self.segmentation_dead_zones,
            seed=self.config.seed,
            settings=self.config.describe(),
            versions=installed_versions(),
        )
        hitch = self._hitch(results)
        hitch = replace(
            hitch,
            provenance=provenance,
            uncertainty={
                direction: trace.uncertainty for direction, trace in traces.items() if trace.uncertainty
            },
            rivals={
                direction: trace.rivals.with_limits(hitch.channels[direction].limits)
                for direction, trace in traces.items()
                if trace.rivals
            },
        )
        return Identification(hitch, traces)

    def _records(self) -> tuple[Record, ...]:
        """Return the tests that are identified from, before strokes are cut."""
        directions = self.campaign.directions
        return self.cycles or tuple(
            record for direction in directions for record in self.campaign.identification(direction)
        )

    def _hitch(self, results: ChannelResults) -> Hitch:
        specs, campaign = self.config.specs.values(), self.campaign
        roles = (DISPLACEMENT, *COMMAND.values(), *(name for spec in specs for name in spec.covariate_names))
        units = {role: campaign.units[role] for role in roles if role in campaign.units}
        records = self._records()
        stops = {c.sign: c.end_stop for c, _ in results.values() if c.end_stop is not None}
        limits = TravelLimits.of(records, stops)
        channels = {direction: replace(channel, limits=limits) for direction, (channel, _) in results.items()}
        dead_zones = {direction: channel.dead_zone for direction, channel in channels.items()}
        drift = 0.0
        if self.config.drift:
            drift = hold_drift(holds(records, dead_zones, limits))
        elif self.config.drift is None:
            responses_s = [_response_s(channel, trace) for channel, trace in results.values()]
            known_s = [response_s for response_s in responses_s if response_s is not None]
            held = holds(records, dead_zones, limits, max(known_s, default=0.0))
            if len(known_s) == len(results) and drift_is_shown(held):
                drift = hold_drift(held)
        return Hitch(channels, campaign.step_s, units, drift=drift)


def _response_s(channel: Channel, trace: ChannelTrace) -> float | None:
    """Return the response time to 63 %, s; None where it is open how a piston moves without a command.

    A plant without integrator goes back by itself: its way back is part of its model, and no drift.
    """
    linear, uncertainty = channel.benchmark.structure.linear, trace.uncertainty
    if linear is None or uncertainty is None or uncertainty.characteristics is None:
        return None
    if linear.transfer_function(tuple(channel.benchmark.values.tolist()))[1][-1] != 0:
        return None
    response = uncertainty.characteristics.response_time
    response_s = 0.0 if response is None else response.value
    return response_s if np.isfinite(response_s) else None


def _check_dead_zone(campaign: Campaign, direction: str, value: float) -> None:
    """Raise SettingsError for a dead zone that no command of the identification tests exceeds."""
    tests = [
        record
        for kind in (direction, CYCLE)
        for record in campaign.identification(kind)
        if direction in record.directions
    ]
    highest = max((float(np.max(np.abs(record.command(direction)))) for record in tests), default=np.inf)
    if not 0 <= value < highest:
        unit = campaign.units.get(COMMAND[direction], "")
        raise SettingsError(
            f"{direction}: dead_zone: expected at least 0 and less than the largest command, "
            f"{highest:.4g} {unit}, got {value:g}"
        )


def _check_covariates(campaign: Campaign, direction: str, names: Sequence[str]) -> None:
    """Raise SettingsError for a covariate that no log of a direction in the campaign has measured."""
    signals = {
        name for kind in (direction, CYCLE) for record in campaign.of_kind(kind) for name in record.signals
    }
    covariates = sorted(signals - {DISPLACEMENT, *COMMAND.values()})
    required = f"one of {', '.join(covariates)}" if covariates else "none, for the logs have no covariates"
    for name in names if signals else ():
        if name not in covariates:
            raise SettingsError(f"{direction}: load is '{name}'; expected {required}")


def _check_window(training: CompensatorConfig | None, channel_data: Mapping[str, ChannelData]) -> None:
    """Raise SettingsError for a window longer than any test: memory is allocated for the whole window."""
    longest = max(int(data.all_tests.valid.sum(axis=1).max()) for data in channel_data.values())
    if training is not None and training.window > max(longest, CompensatorConfig.window):
        raise SettingsError(
            f"training: window: expected at most {longest} samples, the length of the "
            f"longest test, got {training.window}"
        )


def _with_notices(results: ChannelResults, notices: Sequence[str]) -> ChannelResults:
    """Return the channels with notices added to their traces."""
    return {
        direction: (channel, replace(trace, notices=(*trace.notices, *notices)))
        for direction, (channel, trace) in results.items()
    }


def _fingerprints(campaign: Campaign, kinds: tuple[str, ...], recorded: Campaign) -> set[str]:
    """Return those of the tests that are used, as they are used and as they were recorded."""
    names = {record.name for kind in kinds for record in campaign.identification(kind)}
    records = (*campaign.records, *recorded.records)
    return {record.fingerprint for record in records if record.name in names}
