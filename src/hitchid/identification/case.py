"""One campaign on its way to a model: what is asked of it, its tests made ready, and what comes of them."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import numpy as np

from hitchid._support.checkpoints import NOWHERE, Checkpoints
from hitchid._support.versions import installed_versions
from hitchid.data.campaign import Campaign
from hitchid.data.record import COMMAND, CYCLE, DISPLACEMENT, Record
from hitchid.errors import InputError, SettingsError
from hitchid.estimation import Comparison, Search
from hitchid.identification.deadzone import DeadZone
from hitchid.identification.direction import Asked, ChannelTrace, levelled
from hitchid.identification.holding import hold_drift
from hitchid.identification.levelling import calibration_improves, levelling
from hitchid.identification.optional import attempt
from hitchid.identification.phase2 import Training
from hitchid.identification.preparation import Prepared, mixed_dead_zones, prepare
from hitchid.identification.selection import Automatic
from hitchid.identification.trace import describe_channel
from hitchid.identification.two_modes import compare_modes
from hitchid.model import Channel, Hitch, Provenance, TravelLimits, save
from hitchid.structures import Form
from hitchid.structures.nonlinear import NonlinearStructure

Found = Mapping[str, tuple[Channel, ChannelTrace]]


@dataclass(frozen=True)
class Question:
    """What is asked of a campaign; see `identify`.

    Attributes:
        forms: mode to the form of its benchmark, or how it is chosen.
        paper: mode to the paper's form.
        search, training, dead_zones, drift, comparison, seed: see `identify`.
    """

    forms: Mapping[str, Form | Automatic]
    paper: Mapping[str, Form]
    search: Search
    training: Training | None
    dead_zones: Mapping[str, float]
    drift: bool
    comparison: Comparison | None
    seed: int

    def of(self, campaign: Campaign) -> "Question":
        """Return the question with the campaign's first further input, where a choice names none itself."""
        first = campaign.covariates[:1]
        return replace(self, forms={mode: _loaded(form, *first) for mode, form in self.forms.items()})

    def described(self) -> dict[str, object]:
        """Return what is asked as JSON can hold it."""
        return {
            "structure": {mode: _described(form) for mode, form in self.forms.items()},
            "search": repr(self.search),
            "training": None if self.training is None else repr(self.training),
            "dead_zones": dict(self.dead_zones),
            "drift": self.drift,
        }

    def checkpoints(self, folder: Path | None, campaign: Campaign) -> Checkpoints:
        """Return where runs of the same logs, settings and versions are kept, on machines of one kind."""
        if folder is None:
            return NOWHERE
        stamp = {
            "asked": {**self.described(), "forms": repr(self.forms), "seed": self.seed},
            "campaign": campaign.digest,
            "comparison": repr(self.comparison and replace(self.comparison, kept=NOWHERE)),
            "machine": f"{platform.machine()} {jax.default_backend()}",
            "versions": installed_versions(),
        }
        return Checkpoints.of_run(folder, stamp)


@dataclass(frozen=True)
class Identification:
    """An identified model and how it came about.

    Attributes:
        model: the grey box.
        channels: mode to trace.
    """

    model: Hitch
    channels: Mapping[str, ChannelTrace]

    def save(self, folder: str | Path, *, force: bool = False) -> None:
        """Write the model folder with its traces.

        Raises:
            OutputError: the folder exists and `force` is not given, or it cannot be written.
        """
        save(self.model, folder, trace=self.describe(), force=force)

    def describe(self) -> dict[str, dict]:
        """Return mode to trace as JSON can hold it."""
        return {mode: describe_channel(trace) for mode, trace in self.channels.items()}


@dataclass(frozen=True)
class Case:
    """A campaign made ready.

    Attributes:
        campaign: tests of one direction each; where there were none, strokes cut from mixed logs.
        question: what is asked of it.
        cycles: the mixed logs that strokes were cut from.
        cut_at: mode to the dead zone they were cut at.
        seen: fingerprints of all records that are used.
        prepared, asked: mode to its tests, and to what is asked of them.
    """

    campaign: Campaign
    question: Question
    cycles: tuple[Record, ...]
    cut_at: Mapping[str, float]
    seen: frozenset[str]
    prepared: Mapping[str, Prepared]
    asked: Mapping[str, Asked]

    @classmethod
    def of(cls, campaign: Campaign, question: Question, kept: Checkpoints) -> "Case":
        """Make a campaign ready; raises as `identify`."""
        if campaign.unmatched:
            pattern = campaign.unmatched[0]
            raise InputError(
                f"split.test: the pattern '{pattern}' matches none of the {len(campaign.records)} tests"
            )
        forms = question.forms
        for mode, value in question.dead_zones.items():
            _check_dead_zone(campaign, mode, value)
        zones = {mode: DeadZone(0.0, None, 0, "structure") for mode, form in forms.items() if _whole(form)}
        zones |= {mode: DeadZone(value, None, 0, "given") for mode, value in question.dead_zones.items()}
        cut_at: dict[str, float] = {}
        cycles: tuple[Record, ...] = ()
        seen = _fingerprints(campaign, campaign.modes)
        if not campaign.modes:
            cut_at = {mode: zone.value for mode, zone in {**mixed_dead_zones(campaign), **zones}.items()}
            cycles = campaign.identification(CYCLE)
            seen |= _fingerprints(campaign, (CYCLE,))
            campaign = campaign.segmented(cut_at)
            seen |= _fingerprints(campaign, campaign.modes)
        if not campaign.modes:
            raise InputError(
                "no test moves the piston one way, and no cycle holds a stroke to identify from; measure "
                "tests whose command goes well beyond the dead zone, and check the units of the signals"
            )
        prepared = {m: prepare(campaign, m, zones.get(m), load=forms[m].load) for m in campaign.modes}
        _check_window(question.training, prepared)
        asked = {m: _asked(question, m, campaign, kept.part(m)) for m in campaign.modes}
        return cls(campaign, question, cycles, cut_at, frozenset(seen), prepared, asked)

    def balanced(self, found: Found) -> Found:
        """Return benchmarks with the gains on which strokes cut from mixed logs agree best as whole logs.

        Only where logs held out in turn prove those gains better.
        """
        if len(found) < 2 or not self.cut_at:
            return found
        notices: list[str] = []
        hitch, logs = self._hitch(found), self.cycles
        factors = attempt(
            "gain calibration",
            lambda: levelling(hitch, logs) if calibration_improves(hitch, logs) else {},
            notices,
        )
        if factors is None:
            return _noticed(found, notices)
        return {**found, **{mode: levelled(*found[mode], factor) for mode, factor in factors.items()}}

    def closed(self, found: Found) -> Identification:
        """Return the model that channels make up, with all that is to be known of it."""
        campaign, traces = self.campaign, {mode: trace for mode, (_, trace) in found.items()}
        provenance = Provenance(
            identification={mode: self._used(mode) for mode in found},
            validation={mode: self.prepared[mode].validation_names for mode in found},
            held_out={mode: _names(campaign.held_out(mode)) for mode in found},
            seen=self.seen,
            cut_at=self.cut_at,
            seed=self.question.seed,
            settings=self.question.described(),
            versions=installed_versions(),
        )
        same_unit = len({campaign.units[COMMAND[mode]] for mode in found}) == 1
        notices: list[str] = []
        two_modes = None
        if same_unit:
            two_modes = attempt("test of two modes", lambda: compare_modes(self.prepared), notices)
        traces = {mode: trace for mode, (_, trace) in _noticed(found, notices).items()}
        hitch = replace(
            self._hitch(found),
            provenance=provenance,
            two_modes=two_modes,
            uncertainty={mode: trace.uncertainty for mode, trace in traces.items() if trace.uncertainty},
        )
        return Identification(hitch, traces)

    def _used(self, mode: str) -> tuple[str, ...]:
        """Return the names of a direction's tests that it is identified from."""
        left_out = {each.name for each in self.prepared[mode].left_out}
        return tuple(n for n in _names(self.campaign.identification(mode)) if n not in left_out)

    def _hitch(self, found: Found) -> Hitch:
        forms, campaign = self.question.forms.values(), self.campaign
        roles = (DISPLACEMENT, *COMMAND.values(), *(form.load for form in forms if form.load))
        units = {role: campaign.units[role] for role in roles if role in campaign.units}
        whole = self.cycles or tuple(r for mode in found for r in campaign.identification(mode))
        stops = {c.direction: c.end_stop for c, _ in found.values() if c.end_stop is not None}
        limits = TravelLimits.of(whole, stops)
        channels = {mode: _limited(channel, limits) for mode, (channel, _) in found.items()}
        zones = {mode: channel.dead_zone for mode, channel in channels.items()}
        drift = hold_drift(whole, zones) if self.question.drift else 0.0
        return Hitch(channels, campaign.step_s, units, drift=drift)


def _check_dead_zone(campaign: Campaign, mode: str, value: float) -> None:
    """Refuse a dead zone that no command of the tests to identify from goes beyond."""
    tests = [
        record for kind in (mode, CYCLE) for record in campaign.identification(kind) if mode in record.modes
    ]
    highest = max((float(np.max(np.abs(record.command(mode)))) for record in tests), default=np.inf)
    if not 0 <= value < highest:
        raise SettingsError(
            f"{mode}: dead_zone is {value:g} {campaign.units.get(COMMAND[mode], '')}; required from 0 to "
            f"below the largest command, {highest:.4g}"
        )


def _check_window(training: Training | None, prepared: Mapping[str, Prepared]) -> None:
    """Refuse a window that no test fills: it is allocated whole, for every stretch of every test."""
    longest = max(int(tests.everything.valid.sum(axis=1).max()) for tests in prepared.values())
    if training is not None and training.window > max(longest, Training.window):
        raise SettingsError(
            f"training: window is {training.window} samples, required at most {longest}, those of the "
            "longest test"
        )


def _noticed(found: Found, notices: Sequence[str]) -> Found:
    """Return channels with further notices on their traces."""
    return {
        mode: (channel, replace(trace, notices=(*trace.notices, *notices)))
        for mode, (channel, trace) in found.items()
    }


def _limited(channel: Channel, limits: TravelLimits) -> Channel:
    """Return a channel, and the paper's method beside it, held within the limits of the plant."""
    paper = None if channel.paper is None else replace(channel.paper, limits=limits)
    return replace(channel, limits=limits, paper=paper)


def _asked(question: Question, mode: str, campaign: Campaign, kept: Checkpoints) -> Asked:
    return Asked(
        form=question.forms[mode],
        paper=question.paper[mode],
        search=question.search,
        training=question.training,
        seed=question.seed,
        units={"x": campaign.units[DISPLACEMENT], "u": campaign.units[COMMAND[mode]]},
        comparison=question.comparison,
        kept=kept,
    )


def _fingerprints(campaign: Campaign, kinds: tuple[str, ...]) -> set[str]:
    return {record.fingerprint for kind in kinds for record in campaign.identification(kind)}


def _whole(form: Form | Automatic) -> bool:
    """Tell whether a form hears the whole command, dead zone and all."""
    return isinstance(form, Form) and isinstance(form.structure, NonlinearStructure)


def _loaded(form: Form | Automatic, *first: str) -> Form | Automatic:
    if first and isinstance(form, Automatic) and form.load is None:
        return replace(form, load=first[0])
    return form


def _described(form: Form | Automatic) -> dict[str, object]:
    if isinstance(form, Automatic):
        return {"automatic": True, "load": form.load}
    return {
        "structure": form.structure.name,
        "dead_time": form.dead_time,
        "curve": form.curve,
        "spool": form.spool,
        "slope": form.slope,
        "position": form.position,
        "load": form.load,
        "bounds": {name: list(pair) for name, pair in form.bounds.items()},
    }


def _names(records: tuple[Record, ...]) -> tuple[str, ...]:
    return tuple(record.name for record in records)
