"""One direction from its tests to a channel: benchmark, compensators, and the baselines beside them."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key, PRNGKeyArray

from hitchid._support.checkpoints import NOWHERE, Checkpoints
from hitchid._support.progress import ROUNDS, Heard, Progress, Step, part, rounds
from hitchid.baselines.black_box import BlackBox
from hitchid.data.record import MODES
from hitchid.estimation import Comparison, Misfit, Search, Trail, search_trails
from hitchid.identification.baselines import fit_arx, fit_black_box
from hitchid.identification.calibration import calibrate
from hitchid.identification.deadzone import DeadZone
from hitchid.identification.descent import DescentTrace
from hitchid.identification.levelling import with_gain
from hitchid.identification.narx import fit_narx
from hitchid.identification.optional import attempt
from hitchid.identification.phase1 import Phase1, identify_benchmark
from hitchid.identification.phase2 import Training, train_compensator
from hitchid.identification.preparation import Prepared
from hitchid.identification.rollouts import Gate, train_on_rollouts
from hitchid.identification.selection import Automatic, Candidate, choose_form
from hitchid.model import Channel
from hitchid.networks.operating_range import Envelope, Range
from hitchid.structures import Batch, Form
from hitchid.uncertainty import Characteristics, Estimates, Information, Uncertainty, characteristics


@dataclass(frozen=True)
class ChannelTrace:
    """How one direction was identified.

    Attributes:
        dead_zone: the dead zone and where it came from.
        phase1: benchmark, parameters, search.
        phase2: losses of the training of the compensator for predictions; None where none was trained.
        gate: what decided on the compensator for free run; None where none was trained.
        notices: what the user should know of the data and of the choices made for them.
        candidates: the forms that were compared, where the form was chosen automatically.
        seconds: what was fitted to the time it took, s.
        uncertainty: how far the channel can be trusted.
        characteristics: speed map, dead zone, delay and response time; None where there are none.
    """

    dead_zone: DeadZone
    phase1: Phase1
    phase2: DescentTrace | None = None
    gate: Gate | None = None
    notices: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    uncertainty: Uncertainty | None = None
    characteristics: Characteristics | None = None


@dataclass(frozen=True)
class Asked:
    """What is asked of one direction.

    Attributes:
        form: of its benchmark, or how it is chosen.
        paper: the paper's form, for the paper's method beside it.
        search: of phase 1.
        training: of phase 2; None for the benchmark alone.
        seed: every random draw comes from it.
        units: `x` and `u` to the units of displacement and command.
        comparison: how searches are compared; None compares none.
        kept: where what is found is kept and found again.
    """

    form: Form | Automatic
    paper: Form
    search: Search
    training: Training | None
    seed: int
    units: Mapping[str, str]
    comparison: Comparison | None = None
    kept: Checkpoints = NOWHERE

    @property
    def searched(self) -> Form:
        """The form that searches are compared on: what is asked for, or what a choice starts from."""
        return self.form.plain if isinstance(self.form, Automatic) else self.form


def find_benchmark(tests: Prepared, asked: Asked, progress: Progress) -> tuple[Channel, ChannelTrace]:
    """Carry out phase 1 for one direction.

    Args:
        tests: its tests.
        asked: what is asked for.
        progress: called with what is being done and the fraction that is done.

    Raises:
        FitError: nothing moves, or no parameters give a finite error.
    """
    seconds: dict[str, float] = {}
    progress(Step(f"phase 1, {asked.search.name}", 0.02))
    with _timed(seconds, "benchmark"):
        phase1, candidates = _benchmark(tests, asked, part(progress, 0.02, 0.98))
    tests = tests.behind(_revised(tests.dead_zone, candidates))
    channel = replace(_uncompensated(tests, phase1), envelope=envelope_of(tests.everything))
    with _timed(seconds, "speed map"):
        known, said = _characteristics(tests.dead_zone, phase1, asked.units)
    trace = ChannelTrace(
        dead_zone=tests.dead_zone,
        phase1=phase1,
        notices=(*tests.notices, *_vague(phase1), *said),
        candidates=candidates,
        seconds=seconds,
        characteristics=known,
    )
    return channel, trace


def levelled(channel: Channel, trace: ChannelTrace, factor: float) -> tuple[Channel, ChannelTrace]:
    """Return a channel with a factor on its gain, and its trace with it."""
    channel = with_gain(channel, factor)
    known = trace.phase1.known.scaled(factor)
    phase1 = replace(trace.phase1, benchmark=channel.benchmark, known=known)
    said = f"gain times {factor:.4f}, so that whole mixed logs agree best in free run"
    told = trace.characteristics and trace.characteristics.scaled(factor)
    return channel, replace(trace, phase1=phase1, notices=(*trace.notices, said), characteristics=told)


def find_compensators(
    channel: Channel, trace: ChannelTrace, tests: Prepared, asked: Asked, progress: Progress
) -> tuple[Channel, ChannelTrace]:
    """Carry out phase 2 for one direction, and fit the baselines.

    Args:
        channel, trace: of phase 1.
        tests, asked, progress: as for `find_benchmark`.
    """
    seconds, first, tests = dict(trace.seconds), tests, tests.behind(trace.dead_zone)
    if asked.training is None:
        return channel, _with_uncertainty(channel, trace, tests, asked, None, seconds)
    keys = jax.random.split(jax.random.fold_in(jax.random.key(asked.seed), MODES.index(tests.mode)), 4)
    with _timed(seconds, "compensator"):
        channel, losses = _compensated(
            channel,
            tests,
            asked.training,
            keys[0],
            _epochs(progress, "phase 2", 0.2, 0.3),
            asked.kept.part("compensator"),
        )
    trace = replace(trace, phase2=losses)
    if asked.training.rollouts is not None:
        progress(Step("free runs", 0.5))
        with _timed(seconds, "compensator for free run"):
            travel = channel.benchmark.travel(tests.everything)
            assert channel.envelope is not None  # noqa: S101 - given above
            speed, gate = train_on_rollouts(
                tests.everything, travel, channel.envelope, asked.training.rollouts, keys[1], asked.kept
            )
        channel = replace(channel, speed_compensator=speed)
        trace = replace(trace, gate=gate, notices=(*trace.notices, gate.sentence))
    notices: list[str] = []
    paper = None
    if asked.training.baselines:
        channel, paper = _with_baselines(channel, tests, first, asked, keys[2:], progress, seconds, notices)
    trace = replace(trace, notices=(*trace.notices, *notices))
    return channel, _with_uncertainty(channel, trace, tests, asked, paper, seconds)


def _with_uncertainty(
    channel: Channel,
    trace: ChannelTrace,
    tests: Prepared,
    asked: Asked,
    paper: Estimates | None,
    seconds: dict[str, float],
) -> ChannelTrace:
    notices: list[str] = []
    trails: tuple[Trail, ...] = ()
    comparison = asked.comparison
    if comparison is not None:
        with _timed(seconds, "searches compared"):
            misfit = Misfit.of(tests.everything, asked.searched)
            found = attempt(
                "comparison of searches", lambda: search_trails(misfit, comparison, asked.seed), notices
            )
            trails = found or ()
    with _timed(seconds, "bands"):
        bands = attempt(
            "bands around predictions",
            lambda: calibrate(channel, trace.phase1, tests.everything, tests.validation),
            notices,
        )
    searched = tuple(parameter.name for parameter in asked.searched.parameters) if trails else ()
    fit = trace.phase1.fit
    information = attempt(
        "information for the design of tests",
        lambda: Information.of(fit.misfit, fit.position, trace.phase1.moved),
        notices,
    )
    known = Uncertainty(
        trace.phase1.known, paper, bands, trails, searched, information, trace.characteristics
    )
    return replace(trace, uncertainty=known, seconds=seconds, notices=(*trace.notices, *notices))


def envelope_of(batch: Batch) -> Envelope:
    """Return the ranges that tests cover, over the samples that count."""
    counted = np.asarray(batch.counted)

    def spanned(values: np.ndarray) -> Range:
        return Range(jnp.asarray(float(values.min())), jnp.asarray(float(values.max())))

    return Envelope(
        command=spanned(np.abs(np.asarray(batch.command))[counted]),
        displacement=spanned(np.asarray(batch.displacement)[counted]),
        load=spanned(np.asarray(batch.load)),
    )


def _characteristics(
    dead_zone: DeadZone, phase1: Phase1, units: Mapping[str, str]
) -> tuple[Characteristics | None, list[str]]:
    """Return the operating characteristics; a notice takes their place where they cannot be computed."""
    notices: list[str] = []
    moved = phase1.moved
    if not moved.free.any():
        return None, notices
    found = attempt(
        "speed map, delay and response time",
        lambda: characteristics(
            phase1.fit.misfit,
            phase1.fit.position,
            moved,
            dead_zone=dead_zone.stated(units["u"]),
            error=dead_zone.error,
            units=units,
        ),
        notices,
    )
    return found, notices


def _vague(phase1: Phase1) -> list[str]:
    """Return what the tests say of each parameter that they do not determine."""
    return [
        f"{estimate.name.replace('_', ' ')}: {estimate.verdict}"
        for estimate in phase1.estimates
        if not estimate.determined
    ]


def _uncompensated(tests: Prepared, phase1: Phase1) -> Channel:
    return Channel(
        mode=tests.mode,
        direction=tests.direction,
        dead_zone=tests.dead_zone.value,
        end_stop=tests.end_stop,
        benchmark=phase1.benchmark,
    )


def _benchmark(tests: Prepared, asked: Asked, progress: Progress) -> tuple[Phase1, tuple[Candidate, ...]]:
    batch, ramped = tests.everything, tests.dead_zone.origin == "ramps"
    if isinstance(asked.form, Automatic):
        return choose_form(
            batch,
            asked.form,
            asked.search,
            asked.seed,
            units=asked.units,
            opening_known=ramped,
            revised=tests.dead_zone.origin == "tests" and tests.dead_zone.value > 0,
            dead_zone=tests.dead_zone.error,
            progress=progress,
            kept=asked.kept,
        )
    error = f"RMSE / {asked.units['x']}"
    hear = rounds(progress, f"phase 1, {asked.search.name}", 0.0, 0.9, error)
    return _identified(tests, asked, asked.form, asked.kept, hear), ()


def _revised(dead_zone: DeadZone, candidates: Iterable[Candidate]) -> DeadZone:
    """Return the dead zone behind which the form taken was fitted; how far it moved is part of its error."""
    taken = next((each for each in candidates if each.chosen), None)
    if taken is None or taken.dead_zone == dead_zone.value:
        return dead_zone
    moved = abs(taken.dead_zone - dead_zone.value)
    return replace(dead_zone, value=taken.dead_zone, spread=max(dead_zone.spread or 0.0, moved))


def _identified(
    tests: Prepared, asked: Asked, form: Form, kept: Checkpoints, heard: Heard | None = None
) -> Phase1:
    return identify_benchmark(
        tests.everything,
        form,
        asked.search,
        asked.seed,
        units=asked.units,
        dead_zone=tests.dead_zone.error,
        heard=heard,
        kept=kept,
    )


def _compensated(
    channel: Channel,
    tests: Prepared,
    training: Training,
    key: PRNGKeyArray,
    progress: Callable,
    kept: Checkpoints,
) -> tuple[Channel, DescentTrace]:
    compensator, losses = train_compensator(
        (tests.training, channel.simulate_benchmark(tests.training)),
        (tests.validation, channel.simulate_benchmark(tests.validation)),
        training,
        key,
        progress,
        kept,
    )
    return replace(channel, compensator=compensator), losses


def _with_baselines(
    channel: Channel,
    tests: Prepared,
    first: Prepared,
    asked: Asked,
    keys: Key[Array, " k"],
    progress: Progress,
    seconds: dict[str, float],
    notices: list[str],
) -> tuple[Channel, Estimates | None]:
    training = asked.training
    assert training is not None  # noqa: S101 - baselines are fitted beside a compensator

    def black_box() -> BlackBox:
        return fit_black_box(
            tests.training,
            tests.validation,
            hidden=training.hidden,
            descent=training.descent,
            key=keys[0],
            progress=_epochs(progress, "black-box baseline", 0.6, 0.2),
            kept=asked.kept.part("black box"),
        )

    def of_the_paper() -> tuple[Channel, Phase1]:
        kept = asked.kept.part("paper")
        # Its valve is linear: it keeps the dead zone that was found with a linear valve.
        phase1 = _identified(first, asked, asked.paper, kept)
        alone = _uncompensated(first, phase1)
        report_epoch = _epochs(progress, "paper's method", 0.8, 0.2)
        return _compensated(alone, first, training, keys[1], report_epoch, kept)[0], phase1

    with _timed(seconds, "ARX"):
        arx = attempt("ARX", lambda: fit_arx(tests.training, tests.validation), notices)
    with _timed(seconds, "NARX"):
        narx = attempt("NARX", lambda: fit_narx(tests.training, tests.validation), notices)
    with _timed(seconds, "black-box LSTM"):
        lstm = attempt("black-box LSTM", black_box, notices)
    channel = replace(channel, arx=arx, narx=narx, black_box=lstm)
    if asked.form == asked.paper:
        return channel, None
    with _timed(seconds, "paper's method"):
        found = attempt("the paper's method", of_the_paper, notices)
    if found is None:
        return channel, None
    paper, phase1 = found
    return replace(channel, paper=paper), phase1.known


def _epochs(
    progress: Progress, stage: str, start: float, width: float
) -> Callable[[int, float, float], None]:
    """Return what shows an epoch; a training stops early, so its length is not known before."""

    def show(number: int, trained: float, held: float) -> None:
        done = start + width * number / (number + ROUNDS)
        figures = {"training loss": trained, "validation loss": held}
        progress(Step(stage, done, f"epoch {number}", figures))

    return show


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[name] = time.perf_counter() - started
