"""The audit of a long log."""

from collections.abc import Callable

import numpy as np

from hitchid.logs.audit import audit
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import Record

# 2.8 hours at 100 Hz; a day has 8.64 million samples and should take no more than 10 s.
HOLDS, HOLD_SAMPLES, STEP_S = 5000, 200, 0.01


def long_log() -> Campaign:
    """Return a campaign of one log of random levels of an integrator's command."""
    rng = np.random.default_rng(0)
    command = np.repeat(rng.choice([0, 0.4, 0.6], HOLDS), HOLD_SAMPLES)
    signals = {"displacement": 100.0 + 1e-4 * np.cumsum(command - command.mean()), "lifting_command": command}
    return Campaign.of([Record("long", STEP_S, signals, {"displacement": "mm", "lifting_command": "A"})])


def test_audit(timed: Callable) -> None:
    campaign = long_log()
    timed(lambda: audit(campaign), "a log of 1 000 000 samples")
