"""Adaptation of one channel, stroke by stroke: state goes in, state and events come out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hitchid.errors import InputError
from hitchid.live.channel_state import (
    LARGEST,
    BandFactor,
    ChannelEstimates,
    ChannelState,
    Numbered,
    Trial,
    levels_differ,
)
from hitchid.live.estimator import Estimate, scatter_after, speed_distance
from hitchid.live.events import (
    AT_LIMIT,
    CANDIDATE,
    CHANGE_DETECTED,
    DROPPED,
    LEARNED,
    MOVED,
    PROMOTED,
    REFUSED,
    ROLLED_BACK,
    Event,
)
from hitchid.live.gates import Bounds, Gate
from hitchid.live.parameters import DEAD_ZONE, GAIN, Changes
from hitchid.live.settings import AdaptationSettings, alarm_threshold
from hitchid.live.stroke_errors import StrokeErrors, StrokeFit, StrokeRuns, speed_limit
from hitchid.live.strokes import Stroke

# Standard deviations from the estimate beyond which a stroke is suspected; chosen after a log of the nominal
# bench, where of 185 strokes that the starved pump did not affect none was beyond 2.
SUDDEN = 3.0
EVIDENCE_BACK = 20.0  # likelihood ratio at which the model before a promotion returns; chosen
# Strokes at alike commands since a sudden change that do not confirm it yet: a pump may lack oil; chosen.
ALIKE_STROKES = 5
AFTER_ALARM = 4  # latest strokes that stay in the window after an alarm; chosen
MISFIT_RATE = 0.1  # weight of a stroke in the usual misfit; chosen
MOST_SNAPSHOTS = 50  # kept; chosen
NEGLIGIBLE = 0.5  # of the scatter from stroke to stroke: changes that are not worth a candidate; chosen
# Order of the free runs of a stroke; after them those of its own changes.
TARGET_RUN, DEPLOYED_RUN, WATCH_RUN, IDENTIFIED_RUN, CANDIDATE_RUN = range(5)
MOST_CANDIDATES, STROKES_BETWEEN = 3, 2  # at a time, and strokes from one to the next; chosen
OWN = CANDIDATE_RUN + MOST_CANDIDATES
RUNS = OWN + 2

Outcome = tuple[ChannelState, list[Event]]


class ChannelAdaptation:
    """What learns from the strokes of one channel; `identified` is as for `ChannelEstimates`."""

    def __init__(
        self,
        errors: StrokeErrors,
        gate: Gate,
        settings: AdaptationSettings,
        identified: Sequence[float],
        command_unit: str,
    ) -> None:
        self._errors, self._gate, self._settings = errors, gate, settings
        self._bounds = bounds = Bounds.of(errors.channel, settings, command_unit)
        self._estimates = ChannelEstimates(errors, bounds, identified, RUNS)
        self._threshold = alarm_threshold(settings.strokes_between_alarms)

    def prepare(self) -> None:
        """Compile what a stroke needs."""
        self._errors.prepare(RUNS, self._settings.coverage)

    def free_run_error(self, stroke: Stroke) -> float:
        """Return the root mean square error of the channel as identified over a stroke."""
        runs = self._errors.runs(stroke, [Changes()] * RUNS)
        return float(np.sqrt(runs.mean_squares[0]))

    def resumed(self, events: Sequence[Event]) -> ChannelState:
        """Return the state after the events of this channel in a change log, with nothing else learned.

        Raises:
            InputError: an entry puts a parameter, or the factor on the bands, beyond its bounds.
        """
        # Numbers are those of the log, not computed anew: the model is then alike bit for bit.
        snapshots, deployed, band = [Changes()], Changes(), BandFactor()
        for event in events:
            band = BandFactor(event.figures.get("band", band.log))
            beyond = self._bounds.beyond(np.array(event.changes)) or "band" * (abs(band.log) > LARGEST)
            if beyond:
                raise InputError(
                    f"change log: '{event.kind}' at {event.time_s:g} s has a {beyond} of {event.direction} "
                    "beyond the largest change; it was edited, or written with other settings: use those, or "
                    "a new change log"
                )
            if event.kind == PROMOTED:
                snapshots = [*snapshots, event.changes][-MOST_SNAPSHOTS:]
            elif event.kind == ROLLED_BACK:
                snapshots, deployed = snapshots[:-1] or snapshots, event.changes
            elif event.kind == MOVED:
                deployed = event.changes
        estimate = Estimate(np.array(snapshots[-1]), self._estimates.identified)
        return ChannelState(deployed, snapshots[-1], tuple(snapshots), estimate, estimate, band)

    def learn(self, state: ChannelState, stroke: Stroke, number: int) -> Outcome:
        """Return the state after a stroke with its number, and what happened."""
        reason = self._gate.refusal(stroke)
        if reason:
            return state, [self._event(REFUSED, state, stroke, number, reason)]
        # The cheap checks came first: a refused stroke costs no simulation.
        # Without a promotion to watch it is the target once more: each run has its place in one program.
        before = state.target if state.watch is None else state.watch.changes
        tried = [trial.changes for trial in state.candidates]
        tried += [state.target] * (MOST_CANDIDATES - len(tried))
        # All free runs at once, in one compiled call; candidates that are missing are filled up.
        own_changes = self._estimates.own_changes(state, stroke)
        changes = [state.target, state.deployed, before, Changes(), *tried, *own_changes]
        runs = self._errors.runs(stroke, changes)
        # The better of the two: where a stroke tells little of the dead zone, the gain alone fits it better.
        own = OWN + int(np.argmin(runs.mean_squares[OWN:]))
        reason = self._gate.misfit(runs, own, state.misfit)
        beyond = self._bounds.beyond(runs.changes[own])
        if beyond and not reason:
            reason = f"its own {beyond} is beyond the largest change"
        variance = self._estimates.variance(state, float(np.ptp(runs.displacement[TARGET_RUN])))
        # A starved pump looks like a lower gain to the checks before.
        limit = speed_limit(runs, TARGET_RUN, OWN, variance)
        if limit < 1 and not reason:
            reason = f"its speed is limited to {limit:.2g} of the fastest of the model, whatever the command"
        if reason:
            return state, [self._event(REFUSED, state, stroke, number, reason)]
        return self._learned(state, stroke, number, runs, own)

    def _learned(
        self, state: ChannelState, stroke: Stroke, number: int, runs: StrokeRuns, own: int
    ) -> Outcome:
        """Return the state after a stroke that passed the checks."""
        before, events = state, []
        misfit = state.misfit + MISFIT_RATE * (runs.share_left(own) - state.misfit)
        figures, band, coverage = {}, state.band, self._settings.coverage
        # Of the parameters in use, as the bands that are shown are of them.
        half_width = self._errors.half_width(stroke, state.deployed, coverage)
        if half_width is not None:
            is_outside = np.abs(runs.errors[DEPLOYED_RUN]) > half_width(band.factor)
            figures = {"outside": float(is_outside[runs.measured].mean())}
            band = band.advance(figures["outside"], 1 - coverage)
        state = replace(state, misfit=misfit, band=band)
        fits = self._estimates.scattered(state, [runs.fit(run) for run in range(OWN)])
        state = self._compared(state, runs, fits)
        # Back before forward: a rollback drops the candidates that would be judged.
        for decide in (self._watched, self._judged):
            state, happened = decide(state, stroke, number, fits)
            events += happened
        if state.target == before.target:  # otherwise the errors are those of values no longer in use
            state, happened = self._detected(state, stroke, number, fits[TARGET_RUN])
            events += happened
        state, happened = self._estimated(state, stroke, number, fits[TARGET_RUN])
        # Both errors of the same stroke: whether adaptation helps can be read off the log.
        errors, speed_error = np.sqrt(runs.mean_squares), fits[TARGET_RUN].speed_error
        mean, deviation = state.estimate.mean, np.sqrt(np.diag(state.estimate.covariance))
        figures = {
            "error": float(errors[DEPLOYED_RUN]),
            "error_as_identified": float(errors[IDENTIFIED_RUN]),
            "speed_error": speed_error,
            "gain": float(mean[GAIN]),
            "gain_deviation": float(deviation[GAIN]),
            "dead_zone": float(mean[DEAD_ZONE]),
            "dead_zone_deviation": float(deviation[DEAD_ZONE]),
            "band": state.band.log,
            **figures,
        }
        learned = replace(self._event(LEARNED, before, stroke, number, ""), figures=figures)
        return state, [learned, *events, *happened]

    def moved(self, state: ChannelState, stroke: Stroke, number: int) -> Outcome:
        """Return the state with the changes in use one step nearer to the promoted ones."""
        if state.deployed == state.target:
            return state, []
        state = replace(state, deployed=self._bounds.towards(state.deployed, state.target))
        return state, [self._event(MOVED, state, stroke, number, "towards the promoted values")]

    def rolled_back(
        self, state: ChannelState, stroke: Stroke | None, number: int, reason: str, at_s: float = 0.0
    ) -> Outcome:
        """Return the state with the changes before the last promotion, at once and bit for bit.

        Where a user requested it there is no stroke, but a time, s.
        """
        snapshots = state.snapshots[:-1] or state.snapshots  # the identified values always stay
        back = snapshots[-1]
        # All that was learned led to what is taken back: it begins anew, free to move.
        estimate = Estimate(np.array(back), self._estimates.wide)
        state = replace(
            state,
            deployed=back,
            target=back,
            snapshots=snapshots,
            candidates=(),
            watch=None,
            window=(),
            suspects=(),
            detector=type(state.detector)(),
            arrival=estimate,
            estimate=estimate,
        )
        return state, [self._event(ROLLED_BACK, state, stroke, number, reason, at_s=at_s)]

    def _compared(self, state: ChannelState, runs: StrokeRuns, fits: Sequence[StrokeFit]) -> ChannelState:
        """Return the state with candidate and watched changes compared over one more stroke."""

        def compared(trial: Trial, run: int) -> Trial:
            evidence = 0.5 * (fits[TARGET_RUN].squares - fits[run].squares)
            return trial.with_stroke(evidence, *runs.mean_squares[[run, TARGET_RUN]].tolist())

        return replace(
            state,
            candidates=tuple(
                compared(trial, run) for run, trial in enumerate(state.candidates, CANDIDATE_RUN)
            ),
            watch=None if state.watch is None else compared(state.watch, WATCH_RUN),
        )

    def _watched(
        self, state: ChannelState, stroke: Stroke, number: int, fits: Sequence[StrokeFit]
    ) -> Outcome:
        """Roll back where the model before the last promotion is better; stop watching where it is not."""
        watch = state.watch
        if watch is None:
            return state, []
        if watch.evidence > np.log(EVIDENCE_BACK) and watch.squares < watch.against:
            return self.rolled_back(state, stroke, number, "the model before the last promotion is better")
        if watch.strokes >= 2 * self._settings.patience:  # it has held: the way back is that of a user
            return replace(state, watch=None), []
        return state, []

    def _judged(self, state: ChannelState, stroke: Stroke, number: int, fits: Sequence[StrokeFit]) -> Outcome:
        """Promote the candidate where later strokes prove it better, drop it where they do not."""
        kept, events, settings = [], [], self._settings
        # Strokes since a sudden change must be of one plant, at levels that differ, or be many.
        strokes = [*(suspect for _, suspect in state.suspects), stroke]
        confirmed = len(strokes) > ALIKE_STROKES or levels_differ(self._errors.channel, strokes)
        for run, trial in enumerate(state.candidates, CANDIDATE_RUN):
            # A sudden change explains the next stroke as well; a disturbance does not.
            explains = not trial.after_change or abs(fits[run].speed_error) < SUDDEN
            is_better = trial.squares < (1 - settings.improvement) ** 2 * trial.against
            is_proved = is_better and trial.evidence > np.log(settings.evidence)
            if explains and is_proved and (confirmed or not trial.after_change):
                return self._promoted(state, trial, stroke, number)
            evidence = trial.evidence > -np.log(EVIDENCE_BACK)
            if explains and evidence and trial.strokes < settings.patience:
                kept.append(trial)
                continue
            reason = f"not proved better over {trial.strokes} later strokes"
            events.append(self._event(DROPPED, state, stroke, number, reason, trial.changes))
        return replace(state, candidates=tuple(kept)), events

    def _promoted(self, state: ChannelState, trial: Trial, stroke: Stroke, number: int) -> Outcome:
        ratio = np.sqrt(trial.squares / trial.against)
        reason = f"error {ratio:.2f} times that of the model in use over {trial.strokes} later strokes"
        if trial.after_change:  # what was learned before the change no longer holds
            arrival = Estimate(state.arrival.mean, self._estimates.wide)
            state = replace(state, window=state.suspects, suspects=(), arrival=arrival)
            latest, _ = self._estimates.of_window(state, state.window, arrival)
            state = replace(state, estimate=latest)
        state = replace(
            state,
            target=trial.changes,
            snapshots=(*state.snapshots, trial.changes)[-MOST_SNAPSHOTS:],
            candidates=(),
            watch=Trial(state.target),  # what was in use until now, which may return
            detector=type(state.detector)(),
        )
        return state, [self._event(PROMOTED, state, stroke, number, reason, trial.changes)]

    def _detected(self, state: ChannelState, stroke: Stroke, number: int, fit: StrokeFit) -> Outcome:
        """Say where strokes have become faster or slower than the model, and let the estimate move freely."""
        detector = state.detector.advance(fit.speed_error)
        if detector.sum <= self._threshold:
            return replace(state, detector=detector), []
        side = "faster" if detector.faster > detector.slower else "slower"
        arrival = Estimate(state.arrival.mean, self._estimates.wide)
        state = replace(state, detector=type(detector)(), window=state.window[-AFTER_ALARM:], arrival=arrival)
        reason = f"strokes are {side} than the model"
        return state, [self._event(CHANGE_DETECTED, state, stroke, number, reason)]

    def _estimated(self, state: ChannelState, stroke: Stroke, number: int, fit: StrokeFit) -> Outcome:
        """Add a stroke to the window, or to the suspected ones, and make a candidate of what they hold."""
        if abs(speed_distance(fit, state.estimate, self._bounds)) > SUDDEN:
            return self._suspected(state, stroke, number)
        events = self._unconfirmed(state, stroke)
        scatter = scatter_after(state.scatter, fit, state.estimate, self._bounds)
        window = (*state.window, (number, stroke))
        state = replace(state, scatter=scatter, window=window, suspects=())
        candidates = tuple(trial for trial in state.candidates if not trial.after_change)
        state = replace(state, candidates=candidates)
        latest, first = self._estimates.of_window(state, window, state.arrival)
        candidate = self._estimates.cautious(state, window, self._estimates.known(state, latest))
        if len(window) == self._settings.window:
            # The oldest stroke leaves the window; its information stays as the arrival cost of the others.
            state = replace(state, window=window[1:], arrival=first)
        state = replace(state, estimate=latest)
        # Not with every stroke: candidates of nearly the same strokes are nearly the same.
        youngest = min((trial.strokes for trial in state.candidates), default=STROKES_BETWEEN)
        if youngest >= STROKES_BETWEEN and len(state.candidates) < MOST_CANDIDATES:
            state, happened = self._proposed(state, candidate, window, after_change=False)
            events += happened
        return state, events

    def _suspected(self, state: ChannelState, stroke: Stroke, number: int) -> Outcome:
        """Keep a stroke apart that is far from the estimate: a sudden change, if later strokes confirm it."""
        events = []
        if not any(trial.after_change for trial in state.candidates):  # this stroke did not confirm them
            events, state = self._unconfirmed(state, stroke), replace(state, suspects=())
        suspects = (*state.suspects, (number, stroke))[-self._settings.window :]
        state = replace(state, suspects=suspects)
        # From the mean of before, but free: what was known of the machine may no longer hold.
        arrival = Estimate(state.arrival.mean, self._estimates.wide)
        latest, _ = self._estimates.of_window(state, suspects, arrival)
        state = replace(state, candidates=())
        candidate = self._estimates.known(state, latest)
        state, happened = self._proposed(state, candidate, suspects, after_change=True)
        return state, events + happened

    def _unconfirmed(self, state: ChannelState, stroke: Stroke) -> list[Event]:
        """Return that suspected strokes are refused after all."""
        reason = "it is far from the strokes before and after it"
        return [self._event(REFUSED, state, stroke, number, reason) for number, _ in state.suspects]

    def _proposed(
        self, state: ChannelState, estimate: np.ndarray, strokes: Sequence[Numbered], *, after_change: bool
    ) -> Outcome:
        """Return the state with an estimate as candidate, where it differs from the promoted changes."""
        number, stroke = strokes[-1]
        changes = self._bounds.clipped(estimate)
        beyond, events = self._bounds.beyond(estimate), []
        if beyond:
            reason = f"the {beyond} would leave its bounds; it is held there"
            events.append(self._event(AT_LIMIT, state, stroke, number, reason, changes))
        # Else the candidate differs from what is in use by less than strokes differ among themselves.
        away = np.abs(np.subtract(changes, state.target))
        if np.all(away < NEGLIGIBLE * self._bounds.scatter):
            return state, events
        numbers = tuple(number for number, _ in strokes)
        reason = f"fitted to {len(strokes)} strokes" + " since a sudden change" * after_change
        events.append(self._event(CANDIDATE, state, stroke, number, reason, changes, numbers))
        return replace(state, candidates=(*state.candidates, Trial(changes, after_change))), events

    def _event(
        self,
        kind: str,
        state: ChannelState,
        stroke: Stroke | None,
        number: int,
        reason: str,
        changes: Changes | None = None,
        strokes: tuple[int, ...] = (),
        at_s: float = 0.0,
    ) -> Event:
        time_s = at_s if stroke is None else stroke.end * self._gate.step_s
        shown = state.deployed if changes is None else changes
        return Event(kind, time_s, number, self._errors.channel.direction, reason, shown, strokes)
