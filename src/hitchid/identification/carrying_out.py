"""Questions to campaigns carried out phase by phase, all directions of all campaigns at the same time."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import ParamSpec, TypeVar

from hitchid._support.parallel import abreast
from hitchid._support.progress import Progress, strands
from hitchid.data.campaign import Campaign
from hitchid.errors import HitchError
from hitchid.identification.case import Case, Found, Identification, Question
from hitchid.identification.direction import ChannelTrace, find_benchmark, find_compensators
from hitchid.model import Channel

Given = ParamSpec("Given")
Result = TypeVar("Result")
Key = tuple[int, str]
Answer = tuple[Channel, ChannelTrace]


def carried_out(
    campaigns: Sequence[Campaign], question: Question, report: Progress, checkpoints: Path | None = None
) -> tuple[Identification | HitchError, ...]:
    """Carry out phase 1, then phase 2, and put the models together.

    Args:
        campaigns: of one machine each.
        question: what is asked of each.
        report: told where the work stands.
        checkpoints: where finished pieces are kept, for one campaign.

    Returns:
        In the order of the campaigns what was found, or the error with which one ended.
    """

    def opened(campaign: Campaign) -> Case:
        asked = question.of(campaign)
        return Case.of(campaign, asked, asked.checkpoints(checkpoints, campaign))

    cases = [_tried(opened, campaign) for campaign in campaigns]
    going = {number: case for number, case in enumerate(cases) if isinstance(case, Case)}
    keys = [(number, mode) for number, case in going.items() for mode in case.asked]

    def benchmark(key: Key, tell: Progress) -> Answer:
        case, mode = going[key[0]], key[1]
        return find_benchmark(case.prepared[mode], case.asked[mode], tell)

    def balanced(number: int) -> Found:
        return going[number].balanced(_found(benchmarks, number))

    def compensators(key: Key, tell: Progress) -> Answer:
        case, mode = going[key[0]], key[1]
        found = _or_raise(level[key[0]])
        return find_compensators(*found[mode], case.prepared[mode], case.asked[mode], tell)

    def closed(number: int) -> Identification:
        return going[number].closed(_found(answers, number))

    benchmarks = _phase(benchmark, keys, report, 0.02)
    level = {number: _tried(balanced, number) for number in going}
    answers = _phase(compensators, keys, report, 0.5)
    models = abreast(lambda number: _tried(closed, number), going)
    return tuple(
        case if isinstance(case, HitchError) else models[number] for number, case in enumerate(cases)
    )


def _phase(
    work: Callable[[Key, Progress], Answer], keys: Sequence[Key], report: Progress, start: float
) -> Mapping[Key, Answer | HitchError]:
    """Do half of the work for all directions at the same time."""
    one = len({number for number, _ in keys}) == 1
    names = {key: key[1] if one else f"{key[0] + 1}, {key[1]}" for key in keys}
    tell = strands(report, start, 0.48, tuple(names.values()))
    return abreast(lambda key: _tried(work, key, tell[names[key]]), keys)


def _found(answers: Mapping[Key, Answer | HitchError], number: int) -> Found:
    """Return mode to answer of one campaign, or raise the error that one of them is."""
    return {mode: _or_raise(answer) for (of, mode), answer in answers.items() if of == number}


def _or_raise(result: Result | HitchError) -> Result:
    if isinstance(result, HitchError):
        raise result
    return result


def _tried(work: Callable[Given, Result], *args: Given.args, **kwargs: Given.kwargs) -> Result | HitchError:
    try:
        return work(*args, **kwargs)
    except HitchError as error:
        return error
