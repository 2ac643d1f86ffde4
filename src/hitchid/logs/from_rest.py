"""Parts of a log after a gap begin in motion: they are used from where the piston starts out of rest."""

from dataclasses import replace

from hitchid._support.records import Notice, Severity
from hitchid.errors import LogError
from hitchid.logs.campaign import Campaign
from hitchid.logs.kinds import LEAD_IN_S, REST_S, strokes
from hitchid.logs.record import CYCLE, LIFTING, LOWERING, Record
from hitchid.logs.resampling import AFTER_GAP
from hitchid.logs.unification import left_out_notices, refuse, split_usable

FROM_REST = "from-rest"  # code of the notice of a part that was cut to begin at rest
IN_MOTION = f"begins in motion after a gap; expected {REST_S:g} s without a command before a stroke"


def from_rest(campaign: Campaign, otherwise: str = "") -> tuple[Campaign, tuple[str, ...]]:
    """Return a campaign whose parts after gaps begin at rest, and notices of those that do not.

    Models start at rest. After a gap the piston has a speed, from commands that are lost: taken for a start
    at rest, it makes gain and lag wrong, and their intervals narrow. Such parts are left out; where a
    direction has no others, a warned result may be worth more than none.

    Args:
        campaign: its records.
        otherwise: what is wrong where parts in motion are used for want of others, for the warning; without
            it they are left out all the same.

    Raises:
        InputError: no test is left, or the campaign is strict and a part is never at rest.
    """
    parts = [(record.name, record) for record in campaign.records]
    usable, in_motion = split_usable(parts, _from_rest, strict=campaign.strict)
    # By name, so that the campaign keeps its order, which the default split depends on.
    rested = {record.name: record for record in usable}
    # A ramp in motion shows no dead zone, for which tests do instead; a cycle is for want of both directions.
    wanted = {LIFTING, LOWERING} if rested else {LIFTING, LOWERING, CYCLE}
    lacking = wanted - {record.kind for record in usable} if otherwise else set()
    records = [rested.get(record.name, record) for record in campaign.records]
    records = [record for record in records if record.name in rested or record.kind in lacking]
    if not records:
        refuse(in_motion, "tests")
    used = {record.name for record in records}
    left_out = [item for item in in_motion if item.name not in used]
    notices = list(left_out_notices(left_out, len(parts), "tests"))
    if moving := sorted(used - rested.keys()):
        sentence = f"{IN_MOTION}; used for want of others: {otherwise}"
        notices.append(Notice(FROM_REST, sentence, ", ".join(moving), Severity.WARNING))
    return replace(campaign, records=tuple(records)), tuple(map(str, notices))


def _from_rest(record: Record) -> Record:
    """Return a part after a gap from its first stroke after a rest or a turn on; others as they are."""
    # By the notices: nothing else tells a part after a gap from a log that begins in motion.
    codes = {notice.code for notice in record.notices}
    starts = [stroke.start for stroke in strokes(record, {})]
    if AFTER_GAP not in codes or FROM_REST in codes or not starts:
        return record
    # A stroke so near to the gap had no rest before it that anybody saw.
    if starts[0] < round((REST_S - LEAD_IN_S) / record.step_s):
        starts = starts[1:]
    if not starts:
        raise LogError(record.source or record.name, IN_MOTION)
    sentence = f"the first {starts[0] * record.step_s:.3g} s after the gap are left out: the piston may move"
    notices = (*record.notices, Notice(FROM_REST, sentence))
    return replace(record.slice(starts[0], len(record)), notices=notices)
