"""The audit as a whole: silence on clean logs, order, merging, JSON, and that nothing makes it raise."""

import json

import numpy as np
import pytest
from flawed import changed, findings_of
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from hitchid.errors import HitchError
from hitchid.logs.audit import AuditFinding, Severity, audit
from hitchid.logs.audit.context import quality
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import Record


def test_clean_logs_and_none_have_no_findings(clean):
    assert findings_of(clean) == []
    assert audit(Campaign(())) == ()


def test_findings_come_by_level_then_check_then_record(clean):
    stuck, spiky = clean[3].displacement.copy(), clean[1].displacement.copy()
    stuck[500:700] = stuck[500]
    spiky[300] += 30
    both = clean[1].command("lifting")
    records = [
        clean[0],
        changed(clean[1], signals={"displacement": spiky, "lowering_command": both}),
        clean[2],
        changed(clean[3], stuck),
        *clean[4:],
    ]
    levels = list(Severity)
    order = [record.name for record in Campaign.of(records).records]
    findings = findings_of(records)
    assert {finding.severity for finding in findings} >= {Severity.FAULT, Severity.WARNING}
    keys = [(levels.index(f.severity), f.check, order.index(f.record) if f.record else -1) for f in findings]
    assert keys == sorted(keys)


def test_what_four_records_share_is_one_finding_that_names_them(clean):
    def spiky(record):
        displacement = record.displacement.copy()
        displacement[300] += 30
        return changed(record, displacement)

    three = findings_of([*map(spiky, clean[:3]), *clean[3:]], "spikes")
    assert [finding.record for finding in three] == ["lifting-1", "lifting-2", "lifting-3"]
    (one,) = findings_of([*map(spiky, clean[:5]), *clean[5:]], "spikes")
    assert (one.record, one.spans) == ("", ())
    assert "in 5 of 16 tests (lifting-1, lifting-2, lifting-3 …)" in one.what


def test_findings_and_quality_are_json(clean, planted):
    displacement = clean[0].displacement.copy()
    displacement[300] += 30
    (finding,) = findings_of(planted(displacement))
    described = finding.describe()
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert described["level"] == "warning"
    assert described["places"] == [{"record": described["records"][0], "start_s": 3.0, "stop_s": 3.0}]
    described = quality(clean[0]).describe()
    assert json.loads(json.dumps(described, allow_nan=False)) == described
    assert described["samples"] == 1200


VALUES = st.sampled_from([0.0, 1.0, -1.0, 0.5, 1e-300, 1e-12, 1e12, 1e300, -1e300, 0.02, 3.0])
SHAPES = st.sampled_from(["constant", "noise", "ramp", "steps", "walk"])


def made(shape, scale, samples, rng):
    unit = {
        "constant": np.ones(samples),
        "noise": rng.standard_normal(samples),
        "ramp": np.linspace(0, 1, samples),
        "steps": np.repeat(rng.choice([0.0, 0.4, 1.0], samples // 7 + 1), 7)[:samples],
        "walk": np.cumsum(np.round(rng.standard_normal(samples))),
    }
    return scale * unit[shape]


@st.composite
def campaigns(draw):
    """Draw records of any campaign: of any length, scale, unit and step, of one command or two."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    modes = draw(st.sampled_from([("lifting",), ("lowering",), ("lifting", "lowering")]))
    roles = ["displacement", *(f"{mode}_command" for mode in modes)]
    if draw(st.booleans()):
        roles.append("measured")
    units = {"displacement": draw(st.sampled_from(["mm", "m", "deg", "rad", "percent", "1", "V"]))}
    units |= {role: draw(st.sampled_from(["A", "mA", "V", "1", "percent"])) for role in roles[1:]}
    records = []
    step_s = draw(st.sampled_from([0.01, 1e-4, 5.0]))
    for number in range(draw(st.integers(1, 6))):
        samples = draw(st.sampled_from([1, 2, 3, 10, 60, 400]))
        signals = {role: made(draw(SHAPES), draw(VALUES), samples, rng) for role in roles}
        name = draw(st.sampled_from([f"t-{number}", f"t@{number}"]))
        records.append((name, step_s * draw(st.sampled_from([1, 1, 2])), signals, units))
    return records


@given(campaigns())
@settings(suppress_health_check=list(HealthCheck))
def test_any_campaign_is_audited_and_described(drawn):
    try:
        with np.errstate(all="ignore"):
            campaign = Campaign.of([Record(*content) for content in drawn])
    except (HitchError, OverflowError, ValueError):
        assume(False)
    findings = audit(campaign)
    assert json.dumps([finding.describe() for finding in findings], allow_nan=False)
    for finding in findings:
        assert isinstance(finding, AuditFinding)
        assert all(start <= stop for start, stop in finding.spans)
        assert finding.what
        assert finding.advice
    for record in campaign.records:
        assert json.dumps(quality(record).describe(), allow_nan=False)


@pytest.mark.parametrize("folder", ["rig-a", "excavator-boom", "hanging-load"])
def test_measured_logs_have_no_faults(data, folder):
    from hitchid.logs import read

    findings = audit(read(data(folder)))
    assert [finding for finding in findings if finding.severity is Severity.FAULT] == []
    if folder == "rig-a":
        assert [finding for finding in findings if finding.severity is Severity.WARNING] == []
