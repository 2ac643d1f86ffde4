"""Several time bases in one log: what comes out at each time is what was there at that time."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import LogError
from hitchid.logs import ReaderProcess, read_log
from hitchid.logs.content import Content, LogChannel
from hitchid.logs.log_table import resample_to_common_clock, table_of
from hitchid.logs.signal_map import CampaignFile, SignalColumn, SignalMap

EPS = np.finfo(np.float64).eps
SOURCE = Path("log.mf4")
FAST, SLOW = np.arange(1000) / 1000, np.arange(100) / 100
SIGNALS = SignalMap(
    displacement=SignalColumn(column="x", unit="mm"), lifting_command=SignalColumn(column="i", unit="A")
)
WITH_P = SIGNALS.model_copy(update={"covariates": (SignalColumn(column="p"),)})


def line(time_s):
    return 7.0 + 30.0 * time_s


def stepped(time_s, at=0.5):
    return np.where(time_s < at, 0.0, 0.6)


def merged(channels, signals=SIGNALS):
    """Return the table of channels, name to clock and samples."""
    given = {
        name: LogChannel(np.asarray(values, dtype=float), clock_s=clock)
        for name, (clock, values) in channels.items()
    }
    return table_of(Content(SOURCE, given), signals)


def refused(channels, signals=SIGNALS):
    with pytest.raises(LogError, match=f"^{SOURCE}: ") as caught:
        merged(channels, signals)
    return str(caught.value)


def in_force(stamps, values, wanted):
    """Return the last value at or before each instant; before the first, the first."""
    return np.array([values[max(0, np.flatnonzero(stamps <= at + 1e-9).max(initial=0))] for at in wanted])


def assert_line(table):
    """Check that the displacement is the straight line it was, at every stamp of the table."""
    # Interpolation between two doubles near 37: a slope, a product and a sum.
    np.testing.assert_allclose(table.signals["displacement"], line(table.time_s), rtol=0, atol=16 * EPS * 37)


def test_a_fast_displacement_comes_to_the_clock_of_a_slow_command():
    table = merged({"x": (FAST, line(FAST)), "i": (SLOW, stepped(SLOW))})
    assert table.time_s.tobytes() == SLOW.tobytes()
    assert_line(table)
    np.testing.assert_array_equal(table.signals["lifting_command"], stepped(SLOW))
    (notice,) = table.notices
    for part in ("clock of i", "x 0.001 s", "i 0.01 s"):
        assert part in notice
    assert list(table.columns) == ["i", "x"]
    assert {values.size for values in table.columns.values()} == {SLOW.size}


def test_a_fast_command_is_held_on_a_slow_clock():
    rng = np.random.default_rng(3)
    stamps = np.sort(rng.uniform(-0.1, 1.1, 900))
    levels = rng.choice([0.0, 0.3, 0.6], stamps.size)
    table = merged({"x": (SLOW, line(SLOW)), "i": (stamps, levels)})
    truth = in_force(stamps, levels, table.time_s)
    # A stamp within 2 % of a median interval after an instant counts as there already.
    slack = 0.02 * np.median(np.diff(stamps))
    sure = np.array([not np.any((stamps > at) & (stamps <= at + slack)) for at in table.time_s])
    assert sure.mean() > 0.9
    np.testing.assert_array_equal(table.signals["lifting_command"][sure], truth[sure])
    np.testing.assert_array_equal(table.signals["displacement"], line(table.time_s))


@pytest.mark.parametrize("roles", ["command", "lifting_command lowering_command"])
def test_no_command_takes_a_value_between_its_levels(roles):
    # Signed commands, too: a valve never saw the values between.
    columns = {role: SignalColumn(column=role, unit="A") for role in roles.split()}
    signals = SignalMap(displacement=SignalColumn(column="x", unit="mm"), **columns)
    fast = FAST + 0.0004
    commands = {role: (fast, np.sign(np.sin(40 * fast))) for role in columns}
    table = merged({"x": (SLOW, line(SLOW)), **commands}, signals)
    for role in ("lifting_command", "lowering_command"):
        assert set(table.signals[role]) <= {-1.0, 0.0, 1.0}
        assert len(set(table.signals[role])) == 2
    up, down = (table.signals[role] for role in ("lifting_command", "lowering_command"))
    truth = in_force(fast, np.sign(np.sin(40 * fast)), table.time_s)
    np.testing.assert_array_equal(up - down if roles == "command" else up, truth)


@pytest.mark.parametrize(("start", "stop"), [(0.0, 1.0), (0.2, 1.0), (0.0, 0.7), (0.2034, 0.7071), (-3, 9)])
def test_only_the_time_that_all_channels_share_is_left(start, stop):
    fast = np.arange(round(start * 1000), round(stop * 1000)) / 1000
    table = merged({"x": (fast, line(fast)), "i": (SLOW, stepped(SLOW))})
    inside = [stamp for stamp in SLOW if fast[0] <= stamp <= fast[-1]]
    assert set(inside) <= set(table.time_s)
    assert table.time_s[0] >= fast[0] - 1e-9
    assert table.time_s[-1] <= fast[-1] + 1e-9
    assert_line(table)
    np.testing.assert_array_equal(table.signals["lifting_command"], stepped(table.time_s))


@pytest.mark.parametrize("shared", [True, False])
def test_equal_clocks_leave_every_bit_and_say_nothing(shared):
    values = np.sqrt(np.arange(100.0))
    table = merged({"x": (SLOW, values), "i": (SLOW if shared else SLOW.copy(), stepped(SLOW))})
    assert table.notices == ()
    assert table.time_s.tobytes() == SLOW.tobytes()
    assert table.signals["displacement"].tobytes() == values.tobytes()
    assert table.signals["lifting_command"].tobytes() == stepped(SLOW).tobytes()


def test_a_channel_that_holds_the_time_counts_for_all():
    stamps = SLOW + 5.0
    given = {
        "time_s": LogChannel(stamps),
        "x": LogChannel(line(SLOW), clock_s=SLOW),
        "i": LogChannel(stepped(SLOW), clock_s=SLOW + 2.0),
    }
    table = table_of(Content(SOURCE, given), SIGNALS)
    assert table.time_s.tobytes() == stamps.tobytes()
    assert table.signals["displacement"].tobytes() == line(SLOW).tobytes()
    assert table.notices == ()


@pytest.mark.parametrize("step_s", [0.02, 1.0])
def test_a_slow_covariate_leaves_the_clock_to_the_motion(step_s):
    slow = np.arange(0.0, 40.0, step_s)
    clock = np.arange(4000) / 100
    table = merged({"x": (clock, line(clock)), "i": (clock, stepped(clock)), "p": (slow, line(slow))}, WITH_P)
    assert table.time_s.tobytes() == clock.tobytes()
    assert table.signals["displacement"].tobytes() == line(clock).tobytes()
    # Interpolated between its samples, held after the last.
    np.testing.assert_allclose(
        table.signals["p"], line(np.minimum(clock, slow[-1])), rtol=0, atol=16 * EPS * 1300
    )


def test_what_is_logged_on_change_is_held_until_it_changes():
    signals = SIGNALS.model_copy(update={"covariates": (SignalColumn(column="mode"),)})
    clock = np.arange(1000) / 100
    changes, levels = np.array([0.0, 1.0, 1.35, 6.0]), np.array([0.0, 0.6, 0.4, 0.0])
    modes = np.array([3.0, 4.0, 4.0, 5.0])
    channels = {"x": (clock, line(clock)), "i": (changes, levels), "mode": (changes, modes)}
    table = merged(channels, signals)
    assert table.time_s.tobytes() == clock.tobytes()
    np.testing.assert_array_equal(table.signals["lifting_command"], in_force(changes, levels, clock))
    np.testing.assert_array_equal(table.signals["mode"], in_force(changes, modes, clock))
    assert not any("dead times" in notice for notice in table.notices)


def test_a_command_that_is_polled_rarely_is_held_and_named():
    clock, polled = np.arange(4000) / 100, np.arange(40.0)
    table = merged({"x": (clock, line(clock)), "i": (polled, stepped(polled, 7.0))})
    np.testing.assert_array_equal(table.signals["lifting_command"], stepped(table.time_s, 7.0))
    assert table.time_s.size == 3951  # half a step after the last poll nothing is known of the command
    assert any("i is sampled every 1 s, x every 0.01 s" in notice for notice in table.notices)


# --- gaps ---------------------------------------------------------------------------------------------------


def test_nothing_is_made_up_within_a_gap_of_a_fast_channel():
    outside = (FAST < 0.4) | (FAST >= 0.5)
    fast = FAST[outside]
    table = merged({"x": (fast, line(fast)), "i": (SLOW, stepped(SLOW))})
    distance = np.abs(table.time_s[:, None] - fast).min(axis=1)
    assert distance.max() <= 1e-9
    assert set(table.time_s) == set(SLOW[(SLOW < 0.4) | (SLOW >= 0.5)])
    assert_line(table)


def test_a_dropout_within_a_slow_step_is_no_gap():
    fast = np.delete(FAST, slice(405, 414))
    table = merged({"x": (fast, line(fast)), "i": (SLOW, stepped(SLOW))})
    assert table.time_s.tobytes() == SLOW.tobytes()
    assert_line(table)


def two_groups(path, fast):
    """Write an MF4 log of two groups, each on its own clock, and return its path."""
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as log:
        for name, unit, stamps, values in (
            ("x", "mm", fast, line(fast)),
            ("i", "A", SLOW, stepped(SLOW)),
        ):
            log.append([asammdf.Signal(values, stamps, name=name, unit=unit)], acq_name=name)
        log.save(path)
    return path


def test_a_gap_in_a_fast_channel_cuts_the_record(tmp_path):
    fast = FAST[(FAST < 0.3) | (FAST >= 0.6)]
    path = two_groups(tmp_path / "log.mf4", fast)
    with ReaderProcess() as process:
        before, after = read_log(path, CampaignFile(signals=SIGNALS), process)
    assert (before.name, after.name) == ("log@1", "log@2")
    assert (len(before), len(after)) == (30, 40)
    assert any("clock of i" in str(notice) for notice in before.notices)
    assert any("gap of 0.31 s" in str(notice) for notice in after.notices)
    for record in (before, after):
        assert record.step_s == 0.01
        np.testing.assert_allclose(record.displacement, line(record.time_s), rtol=0, atol=32 * EPS * 37)
        np.testing.assert_array_equal(record.command("lifting"), stepped(np.round(record.time_s, 9)))


def test_two_groups_may_call_their_clocks_alike(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "log.h5", "w") as file:
        for group, name, stamps, values in (("a", "x", FAST, line(FAST)), ("b", "i", SLOW, stepped(SLOW))):
            time = file.create_dataset(f"{group}/time_s", data=stamps)
            time.make_scale("time_s")
            time.attrs["units"] = "s"
            file.create_dataset(f"{group}/{name}", data=values).dims[0].attach_scale(time)
    with ReaderProcess() as process:
        (record,) = read_log(tmp_path / "log.h5", CampaignFile(signals=SIGNALS), process)
    assert len(record) == SLOW.size
    np.testing.assert_allclose(record.displacement, line(SLOW), rtol=0, atol=16 * EPS * 37)
    np.testing.assert_array_equal(record.command("lifting"), stepped(SLOW))


# --- clocks that cannot be used -----------------------------------------------------------------------------


def altered(stamps, row, value):
    return np.concatenate([stamps[:row], [value], stamps[row + 1 :]])


NO_CLOCK = ["column", 'campaign.toml: time = "…"']
BAD_CLOCKS = {
    "no common time": ("i", SLOW + 5.0, ["do not overlap"]),
    "command back": ("i", altered(SLOW, 50, -0.01), ["-0.01 s follows 0.49 s"]),
    "displacement back": ("x", altered(SLOW, 50, -0.01), ["-0.01 s follows 0.49 s"]),
    "command without": ("i", None, NO_CLOCK),
    "displacement without": ("x", None, NO_CLOCK),
    "no sample": ("i", SLOW[:0], ["0 samples"]),
    "one sample": ("i", SLOW[:1], ["1 samples"]),
    "no number": ("x", altered(FAST, 500, np.nan), ["column"]),
    "infinity": ("x", altered(FAST, 500, np.inf), ["column"]),
}


@pytest.mark.parametrize(("name", "stamps", "words"), BAD_CLOCKS.values(), ids=BAD_CLOCKS.keys())
def test_a_clock_that_cannot_be_used_is_refused_by_its_channel(name, stamps, words):
    channels = {"x": (FAST, line(FAST)), "i": (SLOW, stepped(SLOW))}
    message = refused({**channels, name: (stamps, np.zeros(100 if stamps is None else stamps.size))})
    assert all(word in message for word in words)
    assert "overlap" in message or f"column '{name}'" in message


@pytest.mark.parametrize("row", [0, 499, 500, 999])
@pytest.mark.parametrize("shift", [0, 1])
def test_of_equal_stamps_the_displacement_takes_the_fitting_sample(row, shift):
    # The stray value stands before or after the true one, at the ends too.
    stamps, values = np.insert(FAST, row, FAST[row]), np.insert(line(FAST), row + shift, 1e6)
    assert_line(merged({"x": (stamps, values), "i": (SLOW, stepped(SLOW))}))


def test_of_samples_with_one_stamp_a_command_takes_the_last():
    stamps = np.insert(FAST, 500, FAST[500])
    values = np.insert(stepped(FAST), 500, 0.0)  # at 0.5 s: before the step, then after it
    table = merged({"x": (FAST, line(FAST)), "i": (stamps, values)})
    np.testing.assert_array_equal(table.signals["lifting_command"], stepped(FAST))


# --- whatever the clocks ------------------------------------------------------------------------------------

clocks = st.builds(
    lambda step_ms, start_ms, samples: (start_ms + step_ms * np.arange(samples)) / 1000,
    st.integers(1, 20),
    st.integers(-200, 200),
    st.integers(60, 900),
)


@given(x=clocks, i=clocks, p=clocks, order=st.permutations(["x", "i", "p"]))
def test_channels_in_any_order_give_the_same_straight_line(x, i, p, order):
    channels = {"x": (x, line(x)), "i": (i, stepped(i, 0.2)), "p": (p, line(p))}
    reordered = {name: channels[name] for name in order}
    if max(clock[0] for clock in (x, i, p)) > min(clock[-1] for clock in (x, i, p)):
        for given_channels in (channels, reordered):
            assert "do not overlap" in refused(given_channels, WITH_P)
        return
    table, again = merged(channels, WITH_P), merged(reordered, WITH_P)
    assert again.time_s.tobytes() == table.time_s.tobytes()
    assert again.notices == table.notices
    for role, samples in table.signals.items():
        assert again.signals[role].tobytes() == samples.tobytes()
    # Stamps and values up to 18 s and 550 mm, a slope over at least 1 ms. A covariate may be held for a step.
    np.testing.assert_allclose(table.signals["displacement"], line(table.time_s), rtol=0, atol=64 * EPS * 550)
    covariate = line(np.clip(table.time_s, p[0], p[-1]))
    np.testing.assert_allclose(table.signals["p"], covariate, rtol=0, atol=64 * EPS * 550)
    nearest = np.abs(table.time_s[:, None] - i).min(axis=1)
    assert nearest.max() <= max(np.diff(clock)[0] for clock in (x, i)) / 2 + 1e-9
    assert np.abs(table.time_s[:, None] - p).min(axis=1).max() <= np.diff(p)[0] + 1e-9
    assert set(table.signals["lifting_command"]) <= {0.0, 0.6}


def test_a_time_that_contradicts_a_clock_is_refused():
    time = np.arange(200) / 100
    slow = LogChannel(np.arange(200.0), clock_s=2 * time)
    shifted = LogChannel(np.arange(200.0), clock_s=time + 5.0)
    names = {"displacement": "x"}
    kept, _, _ = resample_to_common_clock(
        Path("log.tdms"), LogChannel(time), {"displacement": shifted}, names
    )
    np.testing.assert_array_equal(kept, time)
    with pytest.raises(LogError, match=r"column 'x': .*3\.98 s.*1\.99 s"):
        resample_to_common_clock(Path("log.tdms"), LogChannel(time), {"displacement": slow}, names)
