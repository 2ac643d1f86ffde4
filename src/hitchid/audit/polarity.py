"""Check of polarity: lifting raises the displacement and lowering reduces it, over all tests."""

import numpy as np

from hitchid._support.notices import Severity
from hitchid.audit.context import CampaignContext, RecordContext, join_names, travel
from hitchid.audit.finding import AuditFinding
from hitchid.data.record import COMMAND, CYCLE, DIRECTIONS, DISPLACEMENT, LIFTING, LOWERING, RAMP

CLEAR_FRACTION = 0.02  # of the campaign's range; smallest travel with a sign (chosen)
CLEAR_OF_TYPICAL = 0.25  # of the median travel; smallest opposite travel of a test (chosen)


def signs(context: CampaignContext) -> list[AuditFinding]:
    """Find directions whose displacement has the wrong sign.

    The sign of a direction is that of the median travel of its tests while only its command is on, where the
    travel exceeds 6 σ + 2 q and 2 % of the campaign's range. A test of opposite sign, by a quarter of the
    median travel, is a fault of that test; equal signs of both directions are a fault of the campaign. Both
    signs reversed are a warning: either the sensor measures downwards, which identification allows, or the
    commands are swapped.
    """
    findings: list[AuditFinding] = []
    majority_sign: dict[str, int] = {}
    for direction in context.tests[0].record.directions:
        travels = _travels(context, direction)
        if not travels:
            continue
        majority_sign[direction] = (
            1 if np.median([signed_travel for _, signed_travel in travels]) >= 0 else -1
        )
        typical = abs(float(np.median([signed_travel for _, signed_travel in travels])))
        opposed = [
            (test, signed_travel)
            for test, signed_travel in travels
            if signed_travel * majority_sign[direction] < -CLEAR_OF_TYPICAL * typical
        ]
        if len(travels) >= 3 and 2 * len(opposed) < len(travels):
            findings += [
                _contradicting(test, direction, signed_travel, len(travels))
                for test, signed_travel in opposed
            ]
        elif opposed:
            findings.append(_inconsistent(direction, opposed, len(travels)))
    return findings + _compare_directions(majority_sign)


def _travels(context: CampaignContext, direction: str) -> list[tuple[RecordContext, float]]:
    """Return the tests with significant travel under a direction, and that travel."""
    travels = []
    for test in context.tests:
        if test.record.kind not in (direction, CYCLE, RAMP):
            continue
        signed_travel = travel(test, direction)
        if abs(signed_travel) > max(test.quality.noise_bound, CLEAR_FRACTION * test.campaign_range):
            travels.append((test, signed_travel))
    return travels


def _verb(sign: float | int) -> str:
    return "increases" if sign > 0 else "decreases"


def _contradicting(context: RecordContext, direction: str, signed_travel: float, tests: int) -> AuditFinding:
    what = (
        f"the displacement {_verb(signed_travel)} by {abs(signed_travel):.4g} {context.quality.unit} while "
        f"{direction} is commanded; in most of the {tests} tests of {direction} it {_verb(-signed_travel)}"
    )
    advice = "check the sign of the displacement and the assignment of the commands in this log, or remove it"
    return context.finding("sign", Severity.FAULT, what, advice)


def _inconsistent(direction: str, opposed: list[tuple[RecordContext, float]], tests: int) -> AuditFinding:
    names = join_names([test.record.name for test, _ in opposed])
    verb, others = _verb(opposed[0][1]), _verb(-opposed[0][1])
    what = (
        f"in {direction} the displacement {verb} in {len(opposed)} of {tests} tests ({names}) "
        f"and {others} in the others"
    )
    advice = "check the sign of the displacement and the assignment of the commands in each test"
    return AuditFinding("sign", Severity.FAULT, "", DISPLACEMENT, (), what, advice)


def _compare_directions(majority_sign: dict[str, int]) -> list[AuditFinding]:
    if set(majority_sign) != set(DIRECTIONS) or majority_sign == {LIFTING: 1, LOWERING: -1}:
        return []
    if majority_sign[LIFTING] == majority_sign[LOWERING]:
        what = f"the displacement {_verb(majority_sign[LIFTING])} in lifting and in lowering"
        advice = f"check the columns assigned to {COMMAND[LIFTING]} and {COMMAND[LOWERING]} in campaign.toml"
        return [AuditFinding("sign", Severity.FAULT, "", DISPLACEMENT, (), what, advice)]
    what = "the displacement decreases in lifting and increases in lowering"
    advice = (
        "this is correct for a sensor that measures downwards: each direction is identified as measured; "
        "otherwise swap the commands in campaign.toml, or reverse the sign of one signal: set scale = -1 "
        "for its column"
    )
    return [AuditFinding("sign", Severity.WARNING, "", DISPLACEMENT, (), what, advice)]
