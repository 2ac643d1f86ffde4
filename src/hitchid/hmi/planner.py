"""The planner of a campaign: reads its logs, fits the model anew, and says which test comes next and why."""

import contextlib
import json
import threading
import time
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

import hitchid
from hitchid._support.precision import double_precision
from hitchid.bench.excitation import evaluate_ramps
from hitchid.control.sequential_design import (
    CONFIDENCE,
    Choice,
    Duties,
    Posterior,
    best_test,
    draw_tests,
    free_run_slopes,
    information,
    learn,
    lowest_level,
    practice_tests,
    staircase,
    upper_bound,
    within,
)
from hitchid.errors import HitchError, InputError, SettingsError
from hitchid.hmi.adaptive import Start
from hitchid.hmi.campaign_files import MOVES, PROGRESS, VALIDATION, CampaignFiles, read_progress
from hitchid.hmi.plans import AdaptivePlan, Limits, read_goal
from hitchid.hmi.programs import MOVE_STROKES_PER_S, RAMP_TRAVEL, SETTLE_S
from hitchid.identification import prepare
from hitchid.logs import DIRECTIONS, Campaign, from_rest, read
from hitchid.structures import Batch

TEST_S = 10.0  # s, longest test where no goal says otherwise: the paper's; chosen
RAMP_S = 20.0  # s, in which the command of a ramp rises to its limit: as in the fixed programme; chosen
MOST_RAMPS = 3  # of a direction, until one has shown its dead zone; chosen
FIRST_TRAVEL = 0.6  # of the travel ahead, that the first test of a direction may use by its ramp; chosen
START = 0.02  # of the travel, distance of the begin of a test from an end; chosen
MOST_AHEAD = 2  # tests that a direction may have more than the other: a form is chosen by tests of each
LEAST_AHEAD = 0.25  # of the travel, below which a test does not begin where the last one ended; chosen
SPEED_AT_ONCE = 0.9  # of the speed of a move, at which one begins where a model says how; chosen
RISE_OF_MOVE_S = 1.5  # s, that a move takes beside its way; chosen
# Tests of a direction before the first one that is never fitted, and between two; with a goal, by which it is
# judged, more often. Chosen: a sixth to a tenth of the time.
FIRST_VALIDATION, VALIDATION_EVERY = 6, 8
FIRST_VALIDATION_GOAL, VALIDATION_EVERY_GOAL = 3, 4
IDENTIFY_EVERY = 8  # tests between two choices of the form that ships; chosen
NOTHING_GAINED = 0.05  # of the expected error, that five minutes must bring; chosen
FURTHER_S = 300.0  # s, of which is said what they would bring


class CampaignPlanner:
    """What the planner knows between two questions.

    Args:
        settings: of the campaign, as `PlannerLink` sends them.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        self._root = Path(settings["root"])
        self._files = CampaignFiles(self._root / settings["folder"])
        self._plan = AdaptivePlan.model_validate(settings["plan"])
        self._limits = Limits.model_validate(settings["limits"])
        self._interval_s, self._is_virtual = float(settings["interval_s"]), bool(settings["is_virtual"])
        self.waited_s = 0.0  # for what runs beside the tests of a real machine
        self._goal = None if self._plan.goal is None else read_goal(self._plan.goal)
        self._longest_s = self._goal.duration_s if self._goal else TEST_S
        self._posteriors: dict[str, Posterior] = {}
        self._duties: dict[str, Duties] = {}
        self._rounds: list[dict[str, Any]] = []
        if (self._files.folder / PROGRESS).exists():
            self._rounds = read_progress(self._files.folder)["rounds"]
        self._shipped: dict[str, tuple[int, int]] = {}
        self._identification: threading.Thread | None = None
        self._identified_at = self._started_at = 0

    def warm_up(self) -> None:
        """Compile what the first question needs, while the machine is still in its careful start."""
        with contextlib.suppress(HitchError):
            posterior = learn(practice_tests(self._longest_s, self._interval_s))
            duties = Duties(posterior, 0.0, 1.0, 1.0, self._longest_s)
            best_test(
                posterior, duties, start=0.0, available=1.0, longest_s=self._longest_s,
                overhead_s=1.0, seed=0,
            )  # fmt: skip

    @double_precision
    def answer(self, state: Mapping[str, Any]) -> dict[str, Any]:
        """Return the next test, or why the campaign ends.

        Args:
            state: bench time in minutes, displacement, and what the careful start has shown.
        """
        minutes, displacement = float(state["minutes"]), float(state["displacement"])
        start = Start.of(state["start"])
        self._files.save(
            minutes, start, self._rounds
        )  # first: a campaign that is killed while it plans loses nothing
        self._files.hold_out_validations()
        self._files.settle_form(start.directions)
        campaign, notices, validation = self._read(), [""], {}
        if campaign is not None:
            notices = [self._learn(campaign, direction) for direction in start.directions]
            validation = {direction: self._validation(campaign, direction) for direction in start.directions}
            self._identify_beside(campaign)
        self._note_round(minutes, validation, start)
        self._files.save(minutes, start, self._rounds)
        choices = self._choices(displacement, start, campaign)
        stop = self._stop(minutes, validation, choices, start)
        answer: dict[str, Any] = {"stop": stop, "result": {}, "why": stop, "onsets": self._onsets(start)}
        if stop:
            answer["result"] = {
                "reason": stop,
                "minutes": minutes,
                "further": "another five minutes would bring what the parameters leave open down by "
                f"{1 - self._further_ratio(choices):.0%}",
                "rounds": self._rounds,
                "report": self._report(stop, minutes, start),
            }
            return answer
        test = self._validation_test(displacement, start) or max(
            choices, key=lambda choice: choice["gain_per_s"]
        )
        return answer | test | {"why": "; ".join([test["why"], *filter(None, notices)])}

    def _read(self) -> Campaign | None:
        """Return the tests so far; None before the first one that can be used."""
        if not any(self._files.folder.glob("*.csv")):
            return None
        try:
            campaign, _ = from_rest(read(self._files.folder), otherwise="the model may be wrong")
        except SettingsError:
            raise
        except InputError:  # such as of a first ramp that was stopped before anything moved
            return None
        return campaign

    def _learn(self, campaign: Campaign, direction: str) -> str:
        """Fit the model of a direction anew; return what prevents it, or nothing."""
        if not campaign.identification(direction):
            return ""
        try:
            last = self._posteriors.get(direction)
            data = prepare(campaign, direction, None)
            if last is None or data.names != getattr(last, "names", ()):
                self._posteriors[direction] = learn(data.all_tests, last=last, seed=self._plan.seed)
                self._duties.pop(direction, None)
        except HitchError as error:
            return f"{direction}: no model from these tests yet: {error}"
        return ""

    def _validation(self, campaign: Campaign, direction: str) -> list[float]:
        """Return the root mean square errors in free run of the tests that are never fitted."""
        records = campaign.held_out(direction)
        posterior = self._posteriors.get(direction)
        if posterior is None or not records or not self._files.count(f"{VALIDATION}{direction}-"):
            return []
        tests = Batch.of(records, direction, dead_zone=posterior.dead_zone, sign=posterior.tests.sign)
        objective = posterior.objective.with_data(tests).pooled()
        return [float(value) for value in objective.rmse_by_test(posterior.position)]

    def _duties_of(self, direction: str, start: Start) -> Duties:
        if direction not in self._duties:
            posterior = self._posteriors[direction]
            begin, ahead = self._end(direction, start), (1 - 2 * START) * self._limits.travel
            self._duties[direction] = Duties(
                posterior, begin, ahead, self._highest(direction), self._longest_s
            )
        return self._duties[direction]

    def _note_round(self, minutes: float, validation: Mapping[str, Sequence[float]], start: Start) -> None:
        entry: dict[str, Any] = {"minutes": minutes, "tests": len(self._files.logs()), "directions": {}}
        for direction, posterior in self._posteriors.items():
            ships = self._shipped.get(direction)
            errors = validation.get(direction, ())
            entry["directions"][direction] = {
                "rmse": posterior.rmse,
                "open": self._duties_of(direction, start).variance(posterior.precision) ** 0.5,
                "validation": float(np.mean(errors)) if errors else None,
                "determined": ships and ships[0],
                "parameters": ships and ships[1],
            }
        self._rounds.append(entry)

    def _identify_beside(self, campaign: Campaign) -> None:
        """Have the form that ships chosen beside the campaign, every few tests; its verdicts may end it."""
        tests = sum(len(campaign.identification(direction)) for direction in self._posteriors)
        if self._identification is not None:
            # A virtual bench stands still: without waiting, its campaign would be over before the choice is.
            if self._is_virtual and tests >= self._started_at + 2:
                begun_s = time.monotonic()
                self._identification.join()
                self.waited_s += time.monotonic() - begun_s
            if not self._identification.is_alive():
                self._identification = None
        if self._identification is not None or tests < self._identified_at + IDENTIFY_EVERY:
            return
        self._identified_at = self._started_at = tests

        def run() -> None:
            with contextlib.suppress(HitchError):
                identification = hitchid.identify(campaign, training=None, rivals=None, progress=False)
                self._shipped = {
                    direction: (
                        sum(estimate.determined for estimate in trace.phase1.parameter_estimates),
                        len(trace.phase1.parameter_estimates),
                    )
                    for direction, trace in identification.channels.items()
                }

        self._identification = threading.Thread(target=run, daemon=True)
        self._identification.start()

    def _choices(self, displacement: float, start: Start, campaign: Campaign | None) -> list[dict[str, Any]]:
        """Return the best test of each direction that is not too far ahead of the other."""
        choices: list[dict[str, Any]] = []
        counts = {direction: self._files.count(f"{direction}-") for direction in start.directions}
        for direction in start.directions:
            if counts[direction] >= min(counts.values()) + MOST_AHEAD:
                continue
            possible = self._begin(displacement, direction, start)
            if possible is None:
                continue
            begin, begins_at, overhead_s = possible
            ahead = self._ahead(begins_at, direction, start)
            if direction not in self._posteriors:
                choices.append(self._first_test(direction, begin, ahead, start, campaign))
                continue
            duties = self._duties_of(direction, start)
            choice = best_test(
                self._posteriors[direction],
                duties,
                start=begins_at,
                available=ahead,
                longest_s=self._longest_s,
                overhead_s=overhead_s,
                seed=self._plan.seed + 1000 * len(self._rounds) + DIRECTIONS.index(direction),
            )
            if choice is not None:
                before = duties.variance(self._posteriors[direction].precision) ** 0.5
                choices.append(self._described(direction, begin, begins_at, choice, before))
        return choices

    def _described(
        self, direction: str, begin: float | None, begins_at: float, choice: Choice, before: float
    ) -> dict[str, Any]:
        unit, command_unit = self._limits.displacement_unit, self._limits.command_unit
        low, high = choice.levels
        duration_s = len(choice.commands) * self._interval_s
        return {
            "direction": direction,
            "begin": begin,
            "move": self._files.fresh(MOVES),
            "command": choice.commands.tolist(),
            "log": self._files.fresh(direction),
            "gain_per_s": choice.gain_per_s,
            "duration_s": duration_s,
            "why": f"{direction} from {begins_at:.4g} {unit}, {duration_s:.3g} s, {low:.2g} to "
            f"{high:.2g} {command_unit}: what its parameters leave open in free run is "
            f"expected to fall from {before:.2g} to {choice.variance**0.5:.2g} {unit}",
        }

    def _first_test(
        self, direction: str, begin: float | None, ahead: float, start: Start, campaign: Campaign | None
    ) -> dict[str, Any]:
        """Return a ramp, then a test of many levels by what it has shown: no model is known yet."""
        channel = DIRECTIONS.index(direction)
        common = {
            "direction": direction,
            "begin": begin,
            "move": self._files.fresh(MOVES),
            # Before any that is chosen by a model; where the way to its start is the shorter one first.
            "gain_per_s": 1e6 + (begin is None),
        }
        # Of those that were stopped before anything moved there may be several; then the start must do.
        static = None
        for ramp in () if campaign is None else campaign.ramps(direction):
            with contextlib.suppress(HitchError):
                static = evaluate_ramps([ramp], direction, start.signs[channel])
        if static is None and self._files.count(f"ramp-{direction}-") < MOST_RAMPS:
            command = np.linspace(0.0, self._highest(direction), round(RAMP_S / self._interval_s) + 1)
            return common | {
                "command": command.tolist(),
                "travel": RAMP_TRAVEL * self._limits.travel,
                "log": self._files.fresh(f"ramp-{direction}"),
                "duration_s": RAMP_S * start.onsets[channel] / self._highest(direction),
                "why": f"{direction}, a slow ramp until it moves: the dead zone",
            }
        onset, speed = start.onsets[channel], start.speeds[channel]
        if static is not None:
            onset, speed = static.dead_zone, max(static.speed_per_command, speed)
        # At the mean level throughout, half the highest, it stays within its share of the travel.
        highest = min(
            self._highest(direction) - onset, 2 * FIRST_TRAVEL * ahead / (self._longest_s * max(speed, 1e-9))
        )
        rng = np.random.default_rng([self._plan.seed, channel])
        command = staircase(lowest_level(onset), onset + highest, self._longest_s, self._interval_s, rng)
        return common | {
            "command": command.tolist(),
            "log": self._files.fresh(direction),
            "duration_s": len(command) * self._interval_s,
            "why": f"{direction}, {self._longest_s:.3g} s of many levels: the first test of this direction",
        }

    def _validation_test(self, displacement: float, start: Start) -> dict[str, Any] | None:
        """Return a drawn test that will never be fitted, where one is due."""
        first = FIRST_VALIDATION_GOAL if self._goal else FIRST_VALIDATION
        every = VALIDATION_EVERY_GOAL if self._goal else VALIDATION_EVERY
        for direction in start.directions:
            held_out = self._files.count(f"{VALIDATION}{direction}-")
            if (
                self._files.count(f"{direction}-") < first + every * held_out
                or direction not in self._posteriors
                or (possible := self._begin(displacement, direction, start)) is None
            ):
                continue
            begin, begins_at, _ = possible
            posterior, ahead = self._posteriors[direction], self._ahead(begins_at, direction, start)
            seed = self._plan.seed + 7919 * (1 + held_out) + DIRECTIONS.index(direction)
            commands = draw_tests(
                posterior, 8, self._longest_s, self._duties_of(direction, start).highest, seed
            )
            travel, _ = free_run_slopes(posterior, commands, begins_at)
            lengths = [within(row, ahead) for row in travel]
            # The first draw that runs for its whole length, else the longest.
            row = next((n for n, k in enumerate(lengths) if k == commands.shape[1]), int(np.argmax(lengths)))
            command = commands[row, : lengths[row]]
            return {
                "direction": direction,
                "begin": begin,
                "move": self._files.fresh(MOVES),
                "command": command.tolist(),
                "log": self._files.fresh(f"{VALIDATION}{direction}"),
                "duration_s": len(command) * self._interval_s,
                "why": f"{direction}, {len(command) * self._interval_s:.3g} s drawn at random: a test that "
                "is never fitted, by which the model is judged",
            }
        return None

    def _begin(
        self, displacement: float, direction: str, start: Start
    ) -> tuple[float | None, float, float] | None:
        """Return where a test may begin, None for here, its displacement and the time until then, s.

        At the end that it leads away from, as the runs that a model is asked for; where nothing moves back to
        it, here, while there is travel left.
        """
        travel, end = self._limits.travel, self._end(direction, start)
        if len(start.directions) < len(DIRECTIONS):
            is_enough = self._ahead(displacement, direction, start) > LEAST_AHEAD * travel
            return (None, displacement, SETTLE_S) if is_enough else None
        if abs(end - displacement) <= START * travel:
            return None, displacement, SETTLE_S
        way_s = abs(end - displacement) / (MOVE_STROKES_PER_S * travel)
        return end, end, way_s + RISE_OF_MOVE_S + SETTLE_S

    def _onsets(self, start: Start) -> list[float]:
        """Return the commands at which moves may begin, lifting and lowering: from a model near its speed."""
        onsets = list(start.onsets)
        speed = SPEED_AT_ONCE * MOVE_STROKES_PER_S * self._limits.travel
        for direction, duties in self._duties.items():
            onsets[DIRECTIONS.index(direction)] = duties.command_for(speed)
        return onsets

    def _end(self, direction: str, start: Start) -> float:
        low, high = self._limits.displacement
        room = START * self._limits.travel
        return low + room if start.signs[DIRECTIONS.index(direction)] > 0 else high - room

    def _ahead(self, displacement: float, direction: str, start: Start) -> float:
        low, high = self._limits.displacement
        room = START * self._limits.travel
        is_up = start.signs[DIRECTIONS.index(direction)] > 0
        return high - room - displacement if is_up else displacement - low - room

    def _highest(self, direction: str) -> float:
        return self._limits.commands[DIRECTIONS.index(direction)]

    def _stop(
        self,
        minutes: float,
        validation: Mapping[str, Sequence[float]],
        choices: Sequence[Mapping[str, Any]],
        start: Start,
    ) -> str:
        """Return why the campaign ends, empty where it goes on."""
        if not choices:
            return (
                f"the travel is used up and only {start.directions[0]} moves; bring the machine back by hand "
                "and go on with --resume"
            )
        if self._goal is not None and validation:
            bounds = [upper_bound(errors) for errors in validation.values()]
            if max(bounds) <= self._goal.error:
                reached = max(float(np.mean(errors)) for errors in validation.values())
                return (
                    f"the goal is reached: {reached:.3g} {self._limits.displacement_unit} in free run on "
                    f"tests that were never fitted, at most {max(bounds):.3g} at {CONFIDENCE:.0%}"
                )
        shortest_s = min(choice["duration_s"] for choice in choices)
        if minutes + shortest_s / 60 > self._plan.minutes:
            return f"the time is over: {self._plan.minutes:g} minutes"
        is_determined = self._shipped and all(good == count for good, count in self._shipped.values())
        if is_determined and self._goal is None and self._further_ratio(choices) > 1 - NOTHING_GAINED:
            return "all that ships is determined, and five more minutes would bring less than 5 %"
        return ""

    def _further_ratio(self, choices: Sequence[Mapping[str, Any]]) -> float:
        """Return the expected ratio of errors after five more minutes to those now, the larger one."""
        ratios = []
        for direction, posterior in self._posteriors.items():
            own = [choice for choice in choices if choice["direction"] == direction]
            if not own or direction not in self._duties:
                continue
            best = max(own, key=lambda choice: choice["gain_per_s"])
            # A direction has its share of the time; tests as good as the next one.
            tests = FURTHER_S / (best["duration_s"] + SETTLE_S) / len(self._posteriors)
            command = np.array(best["command"])[None]
            _, slopes = free_run_slopes(
                posterior, command, float(best["begin"] or np.asarray(posterior.tests.initial)[-1])
            )
            later = posterior.precision + tests * information(posterior, slopes[0])
            duties = self._duties[direction]
            ratios.append((duties.variance(later) / duties.variance(posterior.precision)) ** 0.5)
        return max(ratios, default=1.0)

    def _report(self, stop: str, minutes: float, start: Start) -> str:
        """Write the report of the campaign; return where, or why there is none."""
        from hitchid.hmi.campaign_report import write_campaign_report

        try:
            duties = {direction: self._duties_of(direction, start) for direction in self._posteriors}
            ends = {direction: self._end(direction, start) for direction in self._posteriors}
            return write_campaign_report(
                self._root, self._plan.name, stop, self._rounds, self._posteriors, duties, ends, self._limits
            )
        except (HitchError, OSError, ValueError, np.linalg.LinAlgError) as error:
            return f"no report could be written: {error}"


def main(arguments: Sequence[str]) -> None:
    """Answer the questions of a bench loop, given the descriptor of the connection and settings as JSON."""
    from hitchid._support.jax_setup import prepare_jax

    prepare_jax()
    connection, planner = Connection(int(arguments[0])), CampaignPlanner(json.loads(arguments[1]))
    planner.warm_up()
    with contextlib.suppress(EOFError, OSError):  # the bench loop has ended
        while True:
            state = json.loads(connection.recv_bytes())
            started_s, planner.waited_s = time.monotonic(), 0.0
            answer: dict[str, Any]
            try:
                answer = planner.answer(state)
            except HitchError as error:
                answer = {"error": str(error)}
            except Exception as error:
                answer = {"error": f"{type(error).__name__}: {error}"}
            answer["seconds"] = time.monotonic() - started_s - planner.waited_s
            connection.send_bytes(json.dumps(answer).encode())
