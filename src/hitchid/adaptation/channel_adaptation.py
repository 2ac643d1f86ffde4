"""Adaptation of one channel, stroke by stroke: state goes in, state and events come out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from hitchid._support.short_repr import short_repr
from hitchid.adaptation.change_detection import ChangeDetector, alarm_threshold
from hitchid.adaptation.conformal import BandFactor
from hitchid.adaptation.estimator import Estimate, determined, window_estimate, with_scatter
from hitchid.adaptation.events import (
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
from hitchid.adaptation.gates import Gate
from hitchid.adaptation.parameters import DEAD_ZONE, GAIN, NAMES, SPOOL_LAG, Changes, has_spool_lag
from hitchid.adaptation.settings import AdaptationSettings
from hitchid.adaptation.stroke_errors import StrokeErrors, StrokeFit, StrokeRuns
from hitchid.adaptation.strokes import Stroke

# Standard deviations, log gain and log lag, and of the dead zone as a share of the command: before anything
# is known of a machine that changed. Chosen.
WIDE = (0.3, 0.01, 0.3)
AFTER_ALARM = 4  # latest strokes that are kept in the window after an alarm; chosen
SUSPICION = 3.0  # sum of the detector from which on only the strokes since are fitted; chosen
LAG_SCATTER, LAG_DRIFT = 0.1, 0.02  # of the log spool lag, as the settings have for the others; chosen
EVIDENCE_BACK = 20.0  # likelihood ratio at which the model before a promotion returns; chosen
# Order of the free runs of a stroke; after them those of its own changes.
TARGET_RUN, DEPLOYED_RUN, CANDIDATE_RUN, WATCH_RUN, IDENTIFIED_RUN, OWN = range(6)
# Of the scatter that strokes show: bound of a standardised distance, mean of its square for normal errors,
# change of the log scatter by a stroke, and limits of the factor. Chosen but for the mean.
LEAST_TOLD = 0.03  # of the information of a stroke in its best direction, that counts in another; chosen
BOUND, BOUNDED_MEAN, SCATTER_RATE, SCATTER_RANGE = 2.0, 0.9205, 0.05, (0.2, 5.0)
LARGEST_LAG = 0.7  # change of the log spool lag: a factor of two; chosen
# Log likelihood ratio of one stroke that counts: of a candidate after a suspected change one later stroke may
# decide, of others not. Chosen.
LARGEST_EVIDENCE, LARGEST_EVIDENCE_AFTER_CHANGE = 5.0, 10.0


@short_repr
class Trial(NamedTuple):
    """Comparison of other changes with those in use, over the strokes since it began.

    Attributes:
        changes: that are tried.
        evidence: log likelihood ratio in their favour.
        squares, against: sums over the strokes of the mean square error, of them and of those in use.
        strokes: compared.
        changed_at: number of the first stroke after a sudden change where only later ones are fitted, or 0.
    """

    changes: Changes
    evidence: float = 0.0
    squares: float = 0.0
    against: float = 0.0
    strokes: int = 0
    changed_at: int = 0

    def with_stroke(self, evidence: float, square: float, against: float) -> "Trial":
        """Return the comparison after one more stroke."""
        largest = LARGEST_EVIDENCE_AFTER_CHANGE if self.changed_at else LARGEST_EVIDENCE
        return self._replace(
            evidence=self.evidence + float(np.clip(evidence, -largest, largest)),
            squares=self.squares + square,
            against=self.against + against,
            strokes=self.strokes + 1,
        )


@short_repr
@dataclass(frozen=True)
class ChannelState:
    """State of the adaptation of one channel.

    Attributes:
        deployed: changes in use.
        target: changes that were promoted; those in use approach them.
        snapshots: changes that were promoted before, the latest last.
        arrival: estimate before the window.
        estimate: after the latest stroke.
        window: strokes that are fitted, with their numbers, the latest last.
        detector: of changes of the speed.
        candidate: changes that are tried; None where there are none.
        watch: those before the last promotion, which may return; None where that is decided.
        band: factor on the half width of the bands.
        scatter: factor on the scatter of the settings that the strokes show.
        accepted, refused: numbers of strokes.
    """

    deployed: Changes
    target: Changes
    snapshots: tuple[Changes, ...]
    arrival: Estimate
    estimate: Estimate
    window: tuple[tuple[int, Stroke], ...]
    detector: ChangeDetector
    candidate: Trial | None
    watch: Trial | None
    band: BandFactor
    scatter: float
    accepted: int
    refused: int


MOST_SNAPSHOTS = 50  # kept; chosen


class ChannelAdaptation:
    """What learns from the strokes of one channel.

    Args:
        errors: of its strokes.
        gate: its checks.
        settings: of the adaptation.
        tests: number of identification tests, from which the scale of the errors is known.
        identified: standard deviations of the identified parameters: log gain, dead zone, log spool lag.
    """

    def __init__(
        self,
        errors: StrokeErrors,
        gate: Gate,
        settings: AdaptationSettings,
        tests: int,
        identified: Sequence[float],
    ) -> None:
        self._errors, self._gate, self._settings = errors, gate, settings
        channel = errors.channel
        command = float(channel.operating_range.command.highest)
        self._units = np.array([1.0, command, 1.0])
        self._scatter = np.diag(
            (self._units * [settings.gain_scatter, settings.dead_zone_scatter, LAG_SCATTER]) ** 2
        )
        self._drift = np.diag((self._units * [settings.gain_drift, settings.dead_zone_drift, LAG_DRIFT]) ** 2)
        self._scales = 2 * np.sqrt(np.diag(self._scatter))
        self._wide = np.diag((self._units * WIDE) ** 2)
        self._allowed = np.array([name in settings.parameters for name in NAMES])
        self._allowed[SPOOL_LAG] &= has_spool_lag(channel)
        lag = LARGEST_LAG
        self._lowest = np.array(
            [np.log1p(-settings.largest_gain), -settings.largest_dead_zone * command, -lag]
        )
        self._highest = np.array([np.log1p(settings.largest_gain), settings.largest_dead_zone * command, lag])
        self._lowest[DEAD_ZONE] = max(self._lowest[DEAD_ZONE], -channel.dead_zone)
        self._step = self._units * settings.change_per_stroke
        self._step[GAIN] = np.log1p(settings.change_per_stroke)
        self._threshold = alarm_threshold(settings.strokes_between_alarms, tests - 1)
        self._identified = np.diag(np.maximum(identified, 2 * np.sqrt(np.diag(self._scatter))) ** 2)

    def prepare(self) -> None:
        """Compile what a stroke needs."""
        self._errors.prepare(OWN + 2, self._settings.coverage)

    def initial_state(self) -> ChannelState:
        """Return the state of a channel as identified."""
        nothing = Changes()
        return ChannelState(
            nothing,
            nothing,
            (nothing,),
            Estimate(np.zeros(3), self._identified),
            Estimate(np.zeros(3), self._identified),
            (),
            ChangeDetector(),
            None,
            None,
            BandFactor(),
            1.0,
            0,
            0,
        )

    def refused(
        self, state: ChannelState, stroke: Stroke, number: int, reason: str
    ) -> tuple[ChannelState, list[Event]]:
        """Return the state after a stroke that is not learned from."""
        return replace(state, refused=state.refused + 1), [
            self._event(REFUSED, state, stroke, number, reason)
        ]

    def learn(self, state: ChannelState, stroke: Stroke, number: int) -> tuple[ChannelState, list[Event]]:
        """Return the state after a stroke, and what happened.

        Args:
            state: before it.
            stroke: of this channel.
            number: of the stroke of the machine.
        """
        reason = self._gate.refusal(stroke)
        if reason:
            return self.refused(state, stroke, number, reason)
        tried = [state.target if trial is None else trial.changes for trial in (state.candidate, state.watch)]
        runs = self._errors.runs(
            stroke, [state.target, state.deployed, *tried, Changes(), *self._own_changes(state, stroke)]
        )
        own = OWN + int(np.argmin(runs.mean_squares[OWN:]))
        reason = self._gate.misfit(runs, own) or self._beyond(runs.changes[own])
        if reason:
            return self.refused(state, stroke, number, reason)
        learned, events = state, []
        state = replace(state, accepted=state.accepted + 1, band=self._covered(state, stroke, runs))
        state = self._compared(state, runs)
        for decide in (self._watched, self._judged):
            state, happened = decide(state, stroke, number)
            events += happened
        (fit,) = self._scattered(state, [runs.fit(TARGET_RUN)])
        if state.detector.advance(fit.speed_error).sum <= SUSPICION:
            state = replace(state, scatter=self._scatter_after(state, fit))
        state, happened = self._estimated(state, stroke, number, fit.speed_error)
        figures = self._figures(state, runs, fit.speed_error)
        event = replace(self._event(LEARNED, learned, stroke, number, ""), figures=figures)
        return state, [event, *events, *happened]

    def _figures(self, state: ChannelState, runs: StrokeRuns, speed_error: float) -> dict[str, float]:
        """Return what the change log says of a stroke."""
        errors = np.sqrt(runs.mean_squares)
        mean, deviation = state.estimate.mean, np.sqrt(np.diag(state.estimate.covariance))
        return {
            "error": float(errors[DEPLOYED_RUN]),
            "error_as_identified": float(errors[IDENTIFIED_RUN]),
            "speed_error": speed_error,
            "gain": float(mean[GAIN]),
            "gain_deviation": float(deviation[GAIN]),
            "dead_zone": float(mean[DEAD_ZONE]),
            "dead_zone_deviation": float(deviation[DEAD_ZONE]),
            "band": state.band.log,
        }

    def moved(self, state: ChannelState, stroke: Stroke, number: int) -> tuple[ChannelState, list[Event]]:
        """Return the state with the changes in use one step nearer to the promoted ones."""
        if state.deployed == state.target:
            return state, []
        way = np.subtract(state.target, state.deployed)
        at = np.add(state.deployed, np.clip(way, -self._step, self._step))
        deployed = state.target if np.all(np.abs(way) <= self._step) else Changes(*map(float, at))
        state = replace(state, deployed=deployed)
        return state, [self._event(MOVED, state, stroke, number, "towards the promoted values")]

    def resumed(self, events: Sequence[Event]) -> ChannelState:
        """Return the state after the events of this channel in a change log, with nothing else learned."""
        state = self.initial_state()
        snapshots, deployed, band = list(state.snapshots), state.deployed, state.band
        for event in events:
            band = BandFactor(event.figures.get("band", band.log))
            if event.kind == PROMOTED:
                snapshots.append(event.changes)
            elif event.kind == ROLLED_BACK:
                snapshots, deployed = snapshots[:-1] or snapshots, event.changes
            elif event.kind == MOVED:
                deployed = event.changes
        estimate = Estimate(np.array(snapshots[-1]), self._identified)
        return replace(
            state,
            deployed=deployed,
            target=snapshots[-1],
            snapshots=tuple(snapshots[-MOST_SNAPSHOTS:]),
            arrival=estimate,
            estimate=estimate,
            band=band,
        )

    def rolled_back(
        self, state: ChannelState, stroke: Stroke | None, number: int, reason: str
    ) -> tuple[ChannelState, list[Event]]:
        """Return the state with the changes before the last promotion, at once and bit for bit."""
        snapshots = state.snapshots[:-1] or state.snapshots
        back = snapshots[-1]
        state = replace(
            state,
            deployed=back,
            target=back,
            snapshots=snapshots,
            candidate=None,
            watch=None,
            window=(),
            arrival=Estimate(np.array(back), self._wide),
            estimate=Estimate(np.array(back), self._wide),
        )
        return state, [self._event(ROLLED_BACK, state, stroke, number, reason)]

    def _own_changes(self, state: ChannelState, stroke: Stroke) -> list[Changes]:
        """Return changes that fit one stroke: of the gain, and of all parameters it tells something about."""
        run = self._errors.runs(stroke, [state.deployed] * (OWN + 2))
        travel = run.displacement[0] - run.displacement[0][0]
        measured = np.where(run.measured, travel + run.errors[0], 0.0)
        factor = measured @ travel / max(float((travel * run.measured) @ travel), np.finfo(float).tiny)
        start = np.add(
            state.deployed, [np.log(np.clip(factor, *np.exp([self._lowest[0], self._highest[0]]))), 0, 0]
        )
        (fit,) = self._errors.fits([stroke], Changes(*start))
        free = self._allowed
        wide = np.linalg.inv(self._wide)
        information = np.where(np.outer(free, free), fit.information, 0.0) + wide
        gradient = np.where(free, fit.gradient, 0.0) - wide @ (fit.at - np.array(state.deployed))
        own = fit.at + np.where(free, np.linalg.solve(information, gradient), 0.0)
        return [Changes(*map(float, start)), Changes(*map(float, own))]

    def _beyond(self, own: np.ndarray) -> str:
        beyond = (own < self._lowest) | (own > self._highest)
        if not beyond.any():
            return ""
        name = NAMES[int(np.argmax(beyond))].replace("_", " ")
        return f"its own {name} is beyond the largest change: {own[int(np.argmax(beyond))]:+.3g}"

    def _covered(self, state: ChannelState, stroke: Stroke, runs: StrokeRuns) -> BandFactor:
        half_width = self._errors.half_width(stroke, state.deployed, self._settings.coverage)
        if half_width is None:
            return state.band
        outside = np.abs(runs.errors[DEPLOYED_RUN]) > half_width(state.band.factor)
        return state.band.advance(float(outside[runs.measured].mean()), 1 - self._settings.coverage)

    def _compared(self, state: ChannelState, runs: StrokeRuns) -> ChannelState:
        """Return the state with candidate and watched changes compared over one more stroke."""
        fits = self._scattered(state, [runs.fit(number) for number in range(OWN)])
        trials = {}
        for name, number in (("candidate", CANDIDATE_RUN), ("watch", WATCH_RUN)):
            trial = getattr(state, name)
            evidence = 0.5 * (fits[TARGET_RUN].squares - fits[number].squares)
            squares = runs.mean_squares[[number, TARGET_RUN]].tolist()
            trials[name] = None if trial is None else trial.with_stroke(evidence, *squares)
        return replace(state, **trials)

    def _watched(self, state: ChannelState, stroke: Stroke, number: int) -> tuple[ChannelState, list[Event]]:
        """Roll back where the model before the last promotion is better; stop watching where it is not."""
        watch = state.watch
        if watch is None:
            return state, []
        if watch.evidence > np.log(EVIDENCE_BACK) and watch.squares < watch.against:
            return self.rolled_back(state, stroke, number, "the model before the last promotion is better")
        if watch.strokes >= 2 * self._settings.patience:
            return replace(state, watch=None), []
        return state, []

    def _judged(self, state: ChannelState, stroke: Stroke, number: int) -> tuple[ChannelState, list[Event]]:
        """Promote the candidate where later strokes prove it better, drop it where they do not."""
        trial, settings = state.candidate, self._settings
        if trial is None:
            return state, []
        better = trial.squares < (1 - settings.improvement) ** 2 * trial.against
        if better and trial.evidence > np.log(settings.evidence):
            ratio = np.sqrt(trial.squares / trial.against)
            if trial.changed_at:
                state = self._since(state, trial.changed_at)
            state = replace(
                state,
                detector=ChangeDetector(),
                target=trial.changes,
                snapshots=(*state.snapshots, trial.changes)[-MOST_SNAPSHOTS:],
                candidate=None,
                watch=Trial(state.target),
            )
            reason = f"error {ratio:.2f} times that of the model in use over {trial.strokes} later strokes"
            return state, [self._event(PROMOTED, state, stroke, number, reason, trial.changes)]
        if trial.strokes >= settings.patience or trial.evidence < -np.log(EVIDENCE_BACK):
            reason = f"not proved better over {trial.strokes} later strokes"
            return replace(state, candidate=None), [
                self._event(DROPPED, state, stroke, number, reason, trial.changes)
            ]
        return state, []

    def _estimated(
        self, state: ChannelState, stroke: Stroke, number: int, speed_error: float
    ) -> tuple[ChannelState, list[Event]]:
        """Add a stroke to the window, and make a candidate of what it holds."""
        events: list[Event] = []
        suspected = state.detector.sum > SUSPICION
        detector = state.detector.advance(speed_error)
        window = (*state.window, (number, stroke))
        arrival = state.arrival
        recent = detector.sum > SUSPICION and detector.since > 0
        if detector.sum > self._threshold:
            side = "faster" if detector.faster > detector.slower else "slower"
            reason = f"strokes are {side} than the model"
            events.append(self._event(CHANGE_DETECTED, state, stroke, number, reason))
            detector = detector._replace(faster=0.0, slower=0.0)
            window, arrival = window[-AFTER_ALARM:], Estimate(state.arrival.mean, self._wide)
        used, before = window, arrival
        if recent:
            used, before = window[-max(detector.since, 1) :], Estimate(state.arrival.mean, self._wide)
        latest, first = self._fitted(state, [stroke for _, stroke in used], before)
        if len(window) == self._settings.window:
            # The oldest stroke leaves the window; what it told stays as the arrival cost of the others.
            window, arrival = window[1:], arrival if recent else first
        state = replace(state, window=window, arrival=arrival, estimate=latest, detector=detector)
        if state.candidate is None or (recent and not suspected):
            state, happened = self._proposed(
                state, latest, [n for n, _ in used], stroke, number, recent=recent
            )
            events += happened
        return state, events

    def _since(self, state: ChannelState, changed_at: int) -> ChannelState:
        """Return the state without what was learned before a sudden change."""
        window = tuple(entry for entry in state.window if entry[0] >= changed_at)
        return replace(state, window=window, arrival=Estimate(state.arrival.mean, self._wide))

    def _fitted(
        self, state: ChannelState, strokes: Sequence[Stroke], arrival: Estimate
    ) -> tuple[Estimate, Estimate]:
        def fits_at(mean: np.ndarray) -> list[StrokeFit]:
            return self._scattered(state, self._errors.fits(strokes, Changes(*map(float, mean))))

        return window_estimate(
            fits_at,
            arrival,
            self._drift,
            lambda fits: determined(fits, state.scatter * self._scales, self._allowed),
        )

    def _scattered(self, state: ChannelState, fits: Sequence[StrokeFit]) -> list[StrokeFit]:
        return [with_scatter(fit, state.scatter**2 * self._scatter) for fit in fits]

    def _scatter_after(self, state: ChannelState, fit: StrokeFit) -> float:
        """Return the scatter after a stroke, from how far it is from what the strokes before predict.

        In each direction in which the stroke tells something the square of its standardised distance has a
        mean of one; that of one bounded by ±2, which a change of the machine hardly moves, of 0.92.
        """
        predicted, free = state.estimate, np.ix_(self._allowed, self._allowed)
        scales = self._scales[self._allowed]
        gradient = fit.gradient - fit.information @ (predicted.mean - fit.at)
        values, directions = np.linalg.eigh(fit.information[free] * np.outer(scales, scales))
        told = values > LEAST_TOLD * values.max()
        distances = (directions.T @ (scales * gradient[self._allowed]))[told] / np.sqrt(values[told])
        spread = (predicted.covariance + self._drift)[free] / np.outer(scales, scales)
        variances = 1 + values[told] * np.diag(directions.T @ spread @ directions)[told]
        squares = np.minimum(distances**2 / variances, BOUND**2)
        change = SCATTER_RATE * float(np.mean(squares) - BOUNDED_MEAN)
        return float(np.clip(state.scatter * np.exp(change), *SCATTER_RANGE))

    def _proposed(
        self,
        state: ChannelState,
        estimate: Estimate,
        strokes: Sequence[int],
        stroke: Stroke,
        number: int,
        *,
        recent: bool,
    ) -> tuple[ChannelState, list[Event]]:
        """Return the state with the estimate as candidate, where it differs from the model in use."""
        bounded = np.clip(estimate.mean, self._lowest, self._highest)
        events = []
        if np.any(bounded != estimate.mean):
            name = NAMES[int(np.argmax(bounded != estimate.mean))].replace("_", " ")
            reason = f"the {name} would leave its bounds; it is held there"
            events.append(self._event(AT_LIMIT, state, stroke, number, reason, Changes(*map(float, bounded))))
        if np.all(np.abs(bounded - np.array(state.target)) < 0.25 * self._scales):
            return replace(state, candidate=None), events
        changes = Changes(*map(float, bounded))
        state = replace(state, candidate=Trial(changes, changed_at=strokes[0] if recent else 0))
        reason = f"fitted to {len(strokes)} strokes"
        events.append(self._event(CANDIDATE, state, stroke, number, reason, changes, tuple(strokes)))
        return state, events

    def _event(
        self,
        kind: str,
        state: ChannelState,
        stroke: Stroke | None,
        number: int,
        reason: str,
        changes: Changes | None = None,
        strokes: tuple[int, ...] = (),
    ) -> Event:
        time_s = 0.0 if stroke is None else stroke.end * self._gate.step_s
        shown = state.deployed if changes is None else changes
        return Event(kind, time_s, number, self._errors.channel.direction, reason, shown, strokes)
