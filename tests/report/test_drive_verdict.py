"""The verdict of a drive says what its tables say, the worst first."""

import re

import numpy as np
import pytest

from hitchid.bench import load_rig
from hitchid.control import Drive, Figures
from hitchid.control.drive import BASELINE, TESTED
from hitchid.control.drive_report import drive_verdict
from hitchid.control.scenarios import COMPENSATED, scenarios
from hitchid.report.document import Rating

ORDER = (Rating.BAD, Rating.CAUTION, Rating.GOOD)
GOOD = Figures(10.0, 0.5, 0.1, 1.0, 0.1, 0.5, 0, None, 0)


@pytest.fixture(scope="module")
def by_name():
    return {scenario.name: scenario for scenario in scenarios(load_rig("nominal"), 15.0)}


def verdict(by_name, own, rival):
    """Return the ratings and the text of the verdict on two controllers."""
    drive = Drive(by_name, {}, {TESTED: own, BASELINE: rival, COMPENSATED: rival}, {}, {})
    findings = drive_verdict(drive)
    return [finding.level for finding in findings], "\n".join(finding.sentence for finding in findings)


def test_a_drive_without_a_fault_has_good_lines_alone(by_name):
    rival = {name: GOOD._replace(iae=12.0) for name in by_name}
    levels, text = verdict(by_name, dict.fromkeys(by_name, GOOD), rival)
    assert set(levels) == {Rating.GOOD}
    assert "at most 0.83 times" in text


@pytest.mark.parametrize("seed", range(50))
def test_every_fault_of_a_table_is_in_the_verdict(by_name, seed):
    rng = np.random.default_rng(seed)
    own = {
        name: Figures(
            iae=float(rng.uniform(7, 12)),
            rmse=1.0,
            overshoot=0.1,
            settling_s=float(rng.choice([1.0, np.inf], p=[0.9, 0.1])),
            final_error=float(rng.choice([0.5, 9.0], p=[0.9, 0.1])),
            valve_actions_per_10_s=float(rng.choice([0.4, 152.0])),
            both_valves_samples=int(rng.choice([0, 3], p=[0.97, 0.03])),
            samples_until_closed=None,
            diverged=int(rng.choice([0, 1], p=[0.97, 0.03])),
        )
        for name in by_name
    }
    levels, text = verdict(by_name, own, dict.fromkeys(by_name, GOOD))
    assert levels == sorted(levels, key=ORDER.index)
    steps = {name: scenario for name, scenario in by_name.items() if scenario.amplitude}
    for name in steps:
        assert (f"settled: {name}" in text or f"; {name}" in text) == np.isinf(own[name].settling_s)
    off = [own[n].final_error for n, s in steps.items() if own[n].final_error > s.tolerance]
    assert ((f"{max(off):.1f} mm off" if off else "mm off") in text) == bool(off)
    slower = [own[n].iae / 10 for n, s in by_name.items() if s.kind.value != "hold" and own[n].iae > 10]
    larger = f"{max(slower):.2f} times." if slower else f"larger than that of {COMPENSATED}"
    assert (larger in text) == bool(slower)
    assert f"{own['hold'].valve_actions_per_10_s:.1f} valve actions" in text
    assert f"{sum(figures.diverged for figures in own.values())} loops diverged" in text
    assert f"on in {sum(figures.both_valves_samples for figures in own.values())} samples" in text
    faults = bool(off) or "Never settled" in text or re.search(r"[1-9]\d* loops diverged|on in [1-9]", text)
    assert (levels[0] is Rating.BAD) == bool(faults)
    assert (Rating.CAUTION in levels) == bool(
        slower or own["hold"].valve_actions_per_10_s > 1 or "The IAE is 1." in text
    )
