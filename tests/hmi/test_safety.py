"""States of the bench loop: nothing moves that was not armed and started, and a stop holds."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import InputError
from hitchid.hmi.safety import Safety, State

SILENCE_S = 0.5
times = st.floats(0.0, 100.0)
EVENTS = st.one_of(
    st.sampled_from(["connect", "finish"]).map(lambda name: (name, {})),
    st.tuples(
        st.sampled_from(["stop", "disconnect"]), st.fixed_dictionaries({"reason": st.text(max_size=5)})
    ),
    st.tuples(st.just("arm"), st.fixed_dictionaries({"is_attended": st.booleans(), "now_s": times})),
    st.tuples(st.just("start"), st.fixed_dictionaries({"now_s": times})),
    st.tuples(st.just("reset"), st.fixed_dictionaries({"is_connected": st.booleans()})),
    st.tuples(
        st.just("check"), st.fixed_dictionaries({"now_s": times, "longest_silence_s": st.just(SILENCE_S)})
    ),
)


def states(events):
    """Yield the states before and after each event, and its name."""
    safety = Safety()
    for name, arguments in events:
        before = safety
        with contextlib.suppress(InputError):
            safety = getattr(safety, name)(**arguments)
        yield before, name, safety


@given(st.lists(EVENTS, max_size=60))
def test_only_reset_arm_and_start_lead_from_stopped_to_running(events):
    led = []
    for before, name, after in states(events):
        if before.state is State.STOPPED and name != "reset":  # with its first reason
            assert (after.state, after.reason) == (State.STOPPED, before.reason)
        led = [] if after.state is State.STOPPED else led
        if after.state is not before.state:
            led = [*led, name]
            assert (after.state is State.RUNNING) == (name == "start")
            assert (after.state is State.ARMED) == (name == "arm")
            if after.state is State.RUNNING:
                assert led[-2:] == ["arm", "start"]
                assert "reset" in led or "connect" in led


@given(st.sampled_from(State), st.booleans(), times, times, times)
def test_a_missing_sign_of_life_stops_what_may_move(state, is_attended, server_s, page_s, now_s):
    safety = Safety(state, is_attended=is_attended, server_s=server_s, page_s=page_s)
    is_missing = now_s - server_s > SILENCE_S or (is_attended and now_s - page_s > SILENCE_S)
    after = safety.check(now_s, SILENCE_S)
    if is_missing and state in (State.ARMED, State.RUNNING):
        assert after.state is State.STOPPED
        assert after.reason
    else:
        assert after == safety


@pytest.mark.parametrize(
    ("state", "event", "advice"),
    [
        (State.DISCONNECTED, lambda s: s.arm(is_attended=True, now_s=0.0), "connect a source first"),
        (State.IDLE, lambda s: s.start(0.0), "arm first"),
        (State.STOPPED, lambda s: s.arm(is_attended=True, now_s=0.0), "reset"),
        (State.STOPPED, lambda s: s.connect(), "reset"),
        (State.RUNNING, lambda s: s.connect(), "stop, or wait"),
        (State.ARMED, lambda s: s.reset(is_connected=True), "start, or stop"),
    ],
)
def test_what_is_not_allowed_says_what_to_do(state, event, advice):
    with pytest.raises(InputError, match=f"the bench is {state}; .*{advice}"):
        event(Safety(state))
