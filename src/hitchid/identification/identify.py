"""Campaign in, model and trace out: dead zones, then phase 1, then phase 2, for each direction."""

import platform
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import jax

from hitchid.benchmark import Form, structure_named
from hitchid.benchmark.nonlinear import NonlinearStructure
from hitchid.campaign import Campaign
from hitchid.checkpoints import NOWHERE, Checkpoints
from hitchid.errors import InputError
from hitchid.fitting import Comparison, Search, Whale
from hitchid.identification.deadzone import DeadZone
from hitchid.identification.direction import Asked, ChannelTrace, find_benchmark, find_compensators, levelled
from hitchid.identification.holding import hold_drift
from hitchid.identification.levelling import levelling
from hitchid.identification.phase2 import Training
from hitchid.identification.preparation import mixed_dead_zones, prepare
from hitchid.identification.selection import Automatic
from hitchid.identification.trace import describe_channel
from hitchid.identification.two_modes import compare_modes
from hitchid.model import Hitch, Provenance, save
from hitchid.precision import double_precision
from hitchid.progress import Progress, Step, part, silent
from hitchid.record import COMMAND, CYCLE, DISPLACEMENT, LIFTING, LOWERING, Record
from hitchid.versions import installed_versions

PAPER_FORMS: Mapping[str, Form] = MappingProxyType(
    {
        LIFTING: Form(structure_named("integrator-second-order")),
        LOWERING: Form(structure_named("first-order-lag")),
    }
)
# Where nothing else is asked for, the choice starts from what holds its place without a command.
CHOSEN: Mapping[str, Automatic] = MappingProxyType(
    {
        LIFTING: Automatic(PAPER_FORMS[LIFTING]),
        LOWERING: Automatic(Form(structure_named("integrator-first-order"))),
    }
)
WHALE = Whale()
COMPARISON = Comparison()
TRAINING = Training()
NONE_KNOWN: Mapping[str, float] = MappingProxyType({})


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


@double_precision
def identify(
    campaign: Campaign,
    *,
    structure: Mapping[str, Form | Automatic] = CHOSEN,
    search: Search = WHALE,
    training: Training | None = TRAINING,
    dead_zones: Mapping[str, float] = NONE_KNOWN,
    drift: bool = False,
    comparison: Comparison | None = COMPARISON,
    seed: int = 0,
    progress: Progress | None = None,
    checkpoints: Path | None = None,
) -> Identification:
    """Identify a grey-box model from the tests of a campaign that are not held out.

    Phase 1 finds each benchmark by a global search and least squares, phase 2 trains each compensator on what
    its frozen benchmark misses (Sun et al. 2025, sec. 2.4.2). Single-direction tests are used where there are
    any; a campaign of mixed cycles alone is cut into strokes.

    Args:
        campaign: tests; ramps, where there are any, give the dead zones.
        structure: mode to the form of its benchmark, or `Automatic` to have it chosen by free run on
            operating points held out in turn, as it is for a mode left out; `PAPER_FORMS` are the paper's.
        search: the global search of phase 1: `Whale`, `DifferentialEvolution` or `MultiStart`.
        training: settings of phase 2; None identifies benchmarks alone.
        dead_zones: mode to dead zone, in the command's unit, where it is known.
        drift: whether the creep of a held piston is identified; otherwise a held piston stands.
        comparison: which searches are compared beside it, from how many seeds; None compares none.
        seed: every random draw comes from it.
        progress: called with what is being done and the fraction of all work that is done.
        checkpoints: folder where finished searches and trainings are kept; with those of a run that was
            stopped, it goes on from there to the same model. None keeps none.

    Raises:
        InputError: there is no test of one direction, all are held out, or a setting does not fit.
        LogError: a ramp ends before the piston moves.
        FitError: the identification could not be carried out on these data.
    """
    if campaign.unmatched:
        pattern = campaign.unmatched[0]
        raise InputError(
            f"split.test: the pattern '{pattern}' matches none of the {len(campaign.records)} tests"
        )
    report = progress or silent
    forms = {mode: _loaded(form, campaign) for mode, form in {**CHOSEN, **structure}.items()}
    settings = {**_describe(forms, search, training, dead_zones), "drift": drift}
    asked = {**settings, "forms": repr(forms), "seed": seed}
    kept = NOWHERE if checkpoints is None else _checkpoints(checkpoints, campaign, asked, comparison)
    zones = {mode: DeadZone(0.0, None, 0, "structure") for mode, form in forms.items() if _whole(form)}
    zones |= {mode: DeadZone(value, None, 0, "given") for mode, value in dead_zones.items()}
    cut_at: dict[str, float] = {}
    cycles: tuple[Record, ...] = ()
    seen = {record.fingerprint for mode in campaign.modes for record in campaign.identification(mode)}
    if not campaign.modes:
        cut_at = {mode: zone.value for mode, zone in {**mixed_dead_zones(campaign), **zones}.items()}
        cycles = campaign.identification(CYCLE)
        seen |= {record.fingerprint for record in cycles}
        campaign = campaign.segmented(cut_at)
        seen |= {record.fingerprint for mode in campaign.modes for record in campaign.identification(mode)}
    if not campaign.modes:
        raise InputError("no test moves the piston one way, and no cycle holds a stroke to identify from")
    channels, traces, prepared, questions = {}, {}, {}, {}

    share = 0.5 / len(campaign.modes)
    for number, mode in enumerate(campaign.modes):
        step = part(report, share * number, share, mode)
        step(Step("dead zone", 0.0))
        prepared[mode] = prepare(campaign, mode, zones.get(mode), load=forms[mode].load)
        units = {"x": campaign.units[DISPLACEMENT], "u": campaign.units[COMMAND[mode]]}
        questions[mode] = Asked(
            forms[mode], PAPER_FORMS[mode], search, training, seed, units, comparison, kept.part(mode)
        )
        channels[mode], traces[mode] = find_benchmark(prepared[mode], questions[mode], step)
    roles = (DISPLACEMENT, *COMMAND.values(), *(form.load for form in forms.values() if form.load))
    units = {role: campaign.units[role] for role in roles if role in campaign.units}
    zone_of = {mode: channel.dead_zone for mode, channel in channels.items()}
    whole = cycles or tuple(r for mode in campaign.modes for r in campaign.identification(mode))
    hitch = Hitch(channels, campaign.step_s, units, drift=hold_drift(whole, zone_of) if drift else 0.0)
    if len(channels) > 1 and cut_at:
        factors = levelling(hitch, cycles)
        for mode, factor in factors.items():
            channels[mode], traces[mode] = levelled(channels[mode], traces[mode], factor)
    for number, mode in enumerate(campaign.modes):
        step = part(report, 0.5 + share * number, share, mode)
        channels[mode], traces[mode] = find_compensators(
            channels[mode], traces[mode], prepared[mode], questions[mode], step
        )
    provenance = Provenance(
        identification={mode: _names(campaign.identification(mode)) for mode in campaign.modes},
        validation={mode: prepared[mode].validation_names for mode in campaign.modes},
        held_out={mode: _names(campaign.held_out(mode)) for mode in campaign.modes},
        seen=frozenset(seen),
        cut_at=cut_at,
        seed=seed,
        settings=settings,
        versions=installed_versions(),
    )
    same_unit = len({campaign.units[COMMAND[mode]] for mode in campaign.modes}) == 1
    hitch = replace(
        hitch,
        channels=channels,
        provenance=provenance,
        two_modes=compare_modes(prepared) if same_unit else None,
        uncertainty={mode: trace.uncertainty for mode, trace in traces.items() if trace.uncertainty},
    )
    return Identification(hitch, traces)


def _checkpoints(
    folder: Path, campaign: Campaign, asked: Mapping[str, object], comparison: Comparison | None
) -> Checkpoints:
    """Return where a run is kept: one of the same logs, settings and versions, on a machine of one kind."""
    stamp = {
        "asked": dict(asked),
        "campaign": campaign.digest,
        "comparison": repr(comparison and replace(comparison, kept=NOWHERE)),
        "machine": f"{platform.machine()} {jax.default_backend()}",
        "versions": installed_versions(),
    }
    return Checkpoints.of_run(folder, stamp)


def _whole(form: Form | Automatic) -> bool:
    """Tell whether a form hears the whole command, dead zone and all."""
    return isinstance(form, Form) and isinstance(form.structure, NonlinearStructure)


def _loaded(form: Form | Automatic, campaign: Campaign) -> Form | Automatic:
    """Return the choice with the campaign's first further input, where it names none itself."""
    if isinstance(form, Automatic) and form.load is None and campaign.covariates:
        return replace(form, load=campaign.covariates[0])
    return form


def _names(records: tuple) -> tuple[str, ...]:
    return tuple(record.name for record in records)


def _describe(
    forms: Mapping[str, Form | Automatic],
    search: Search,
    training: Training | None,
    dead_zones: Mapping[str, float],
) -> dict[str, object]:
    """Return what was asked for as JSON can hold it."""
    return {
        "structure": {
            mode: {"automatic": True, "load": form.load}
            if isinstance(form, Automatic)
            else {
                "structure": form.structure.name,
                "dead_time": form.dead_time,
                "curve": form.curve,
                "spool": form.spool,
                "slope": form.slope,
                "position": form.position,
                "load": form.load,
                "bounds": {name: list(pair) for name, pair in form.bounds.items()},
            }
            for mode, form in forms.items()
        },
        "search": repr(search),
        "training": None if training is None else repr(training),
        "dead_zones": dict(dead_zones),
    }
