"""Steady speed with its band, and its inverse as a table."""

import csv
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

import handmade
from hitchid.errors import InputError, OutputError
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Characteristics, Estimates, Quantity, SpeedPoint, Uncertainty
from hitchid.structures import NONLINEARITY_PARAMETERS, PhysicalModel, structure_named
from hitchid.structures.nonlinearity import NEUTRAL
from report import reported

EPS = np.finfo(np.float64).eps
CURVED = handmade.hitch_of(handmade.channel(LIFTING, "integrator-first-order", shape=True))
COVERED = handmade.hitch(covered=handmade.envelope())
LEVELS, LOADS = (0.6, 0.9, 1.2), (100.0, 120.0, 140.0)


def curved(**values):
    """Return a model with one lifting channel and given nonlinearities, U = 1.2 A, mean load 120 bar."""
    row = [values.get(p.name, NEUTRAL.get(p.name, 0.0)) for p in NONLINEARITY_PARAMETERS]
    effects = {name: values.get(f"{name}_by_pressure", 0.0) for name in ("gain", "opening")}
    channel = handmade.channel(LIFTING, covered=handmade.envelope(command=(0.0, 1.2)))
    structure = structure_named("integrator")
    curves = handmade.scheduled(structure, row, **effects)
    benchmark = PhysicalModel(structure, jnp.array([30.0]), jnp.zeros(()), *curves)
    return handmade.hitch_of(replace(channel, benchmark=benchmark))


def with_map(model, *, open_level=None, errors=(0.05, 0.02)):
    """Return a model with a speed map: intervals of −10 % and +20 %, open above at one level."""
    speeds = model.speed(np.array(LEVELS)[:, None], LIFTING, load=np.array(LOADS)).speed
    points = tuple(
        SpeedPoint.of(level, load, v, (0.9 * v, None if level == open_level else 1.2 * v), 30.0)
        for level, row in zip(LEVELS, speeds.tolist(), strict=True)
        for load, v in zip(LOADS, row, strict=True)
    )
    dead_zone = Quantity("dead zone", "A", 0.35, (0.3, 0.4), determined=True)
    characteristics = Characteristics("A", "mm/s", "pressure", dead_zone, None, 0.9, None, None, points, ())
    estimates = tuple(
        reported.estimate(name, value=0.1, error=error, interval=(None, None), linear=True)
        for name, error in zip(("position_slope", "gain_by_pressure"), errors, strict=True)
    )
    assessed = Uncertainty(
        Estimates(estimates, (), ((1.0, 0.0), (0.0, 1.0)), 5, 5), None, None, characteristics
    )
    return replace(model, uncertainty={LIFTING: assessed})


def test_speed_is_gain_times_the_effective_command_signed_as_displacement():
    commands = np.array([[0.0, 0.2, 0.35], [0.5, 1.0, -1.0]])
    up, down = (COVERED.speed(commands, direction) for direction in (LIFTING, LOWERING))
    beyond = [[0.0, 0.0, 0.0], [0.15, 0.65, -0.65]]
    np.testing.assert_allclose(up.speed, 30.0 * np.array(beyond), rtol=0, atol=4 * 30 * EPS)
    beyond = [[0.0, 0.0, 0.1], [0.25, 0.75, -0.75]]
    np.testing.assert_allclose(down.speed, -20.0 * np.array(beyond), rtol=0, atol=4 * 20 * EPS)
    assert (up.band, up.unit) == (None, "mm/s")


def test_speed_is_what_a_simulation_settles_at(make_record):
    model = curved(opening=0.1, exponent=1.5, saturation=0.4, gain_by_pressure=0.3, opening_by_pressure=0.05)
    command, load = 1.1, 135.0
    record = make_record(np.full(200, 100.0), np.r_[0.0, np.full(199, command)])
    pressure = {**record.signals, "pressure": np.full(200, load)}
    record = replace(record, signals=pressure, units={**record.units, "pressure": "bar"})
    travelled = np.asarray(model.simulate(record))
    # An integrator without a gain along the stroke moves at constant speed; sums of 200 numbers around 100.
    np.testing.assert_allclose(
        np.diff(travelled)[1:] / 0.01,
        float(model.speed(command, load=load).speed),
        rtol=0,
        atol=200 * EPS * 1e4,
    )


def test_commands_displacements_and_loads_broadcast():
    grid = CURVED.speed(
        np.array([0.5, 0.9])[:, None, None],
        displacement=np.array([80.0, 120.0])[:, None],
        load=[100.0, 140.0],
    )
    assert grid.speed.shape == (2, 2, 2)
    alone = CURVED.speed(0.9, displacement=80.0, load=140.0).speed
    assert grid.speed[1, 0, 1] == pytest.approx(alone, rel=8 * EPS)
    assert CURVED.speed(0.9).speed == CURVED.speed(0.9, displacement=100.0, load=120.0).speed


def test_at_its_points_the_band_is_the_speed_maps():
    model = with_map(curved(gain_by_pressure=0.3))
    steady = model.speed(np.array(LEVELS)[:, None], load=np.array(LOADS))
    np.testing.assert_allclose(steady.band.lower, 0.9 * steady.speed, rtol=1e-12)
    np.testing.assert_allclose(steady.band.upper, 1.2 * steady.speed, rtol=1e-12)


def test_the_band_ends_at_the_dead_zone_and_stays_beyond():
    model = with_map(curved())
    steady = model.speed([0.1, 0.3, 0.34, 0.45, 0.7, 3.0])
    np.testing.assert_allclose(steady.band.upper[:2], 0.0, atol=0)
    # Between the lower end of the dead zone's interval, 0.3 A, and the lowest level, 0.6 A.
    wide = 0.2 * 30 * 0.25 * np.array([0.04, 0.15]) / 0.3
    np.testing.assert_allclose(steady.band.upper[2:4], steady.speed[2:4] + wide, rtol=1e-12)
    assert steady.band.lower[2] == 0.0
    np.testing.assert_allclose(steady.band.lower[4:], 0.9 * steady.speed[4:], rtol=1e-12)


def test_an_open_interval_opens_the_band_next_to_it():
    steady = with_map(curved(), open_level=1.2).speed([0.8, 0.9, 1.0, 1.2, 1.5])
    assert np.isinf(steady.band.upper).tolist() == [False, False, True, True, True]


def test_away_from_mid_stroke_the_strokes_gain_error_counts():
    model = with_map(curved(position_slope=0.2))
    steady = model.speed(0.9, displacement=130.0)
    # ξ = 0.5, slope ± 0.05; in quadrature with the 20 % of the map.
    share = np.hypot(0.2, 1.959963984540054 * 0.5 * 0.05)
    np.testing.assert_allclose(steady.band.upper / steady.speed - 1, share, rtol=1e-12)
    steady = model.speed(0.9, load=165.0)
    share = np.hypot(0.2, 1.959963984540054 * (165.0 - 140.0) / 25.0 * 0.02)
    np.testing.assert_allclose(steady.band.upper / steady.speed - 1, share, rtol=1e-12)
    unknown = with_map(curved(position_slope=0.2), errors=(None, 0.02))
    assert np.isinf(unknown.speed(0.9, displacement=130.0).band.upper)
    assert np.isfinite(unknown.speed(0.9).band.upper)


def test_a_lowering_band_has_its_smaller_end_first():
    channel = replace(curved().channels[LIFTING], sign=-1)
    steady = with_map(handmade.hitch_of(channel)).speed([0.6, 0.9])
    assert np.all(steady.speed < 0)
    assert np.all((steady.band.lower < steady.speed) & (steady.speed < steady.band.upper))


@settings(max_examples=10)
@given(
    opening=st.floats(-0.5, 0.6),
    exponent=st.floats(1 / 3, 3.0),
    saturation=st.floats(0.3, 1e4),
    load=st.floats(60.0, 180.0),
    displacement=st.floats(20.0, 180.0),
    shares=st.lists(st.floats(1e-3, 1.0), min_size=1, max_size=9),
)
def test_the_command_for_a_speed_gives_that_speed(opening, exponent, saturation, load, displacement, shares):
    model = curved(
        opening=opening,
        exponent=exponent,
        saturation=saturation,
        position_slope=0.3,
        position_curve=-0.2,
        gain_by_pressure=0.2,
    )
    at = {"displacement": displacement, "load": load}
    slowest, fastest = (float(model.speed(command, **at).speed) for command in (0.3513, 1.55))
    speeds = np.unique([slowest + share * (fastest - slowest) for share in shares])
    try:
        table = model.inverse_table(speeds=speeds[speeds > 0], **at)
    except InputError as error:
        if "too flat" not in str(error):
            raise
        reject()
    np.testing.assert_allclose(model.speed(table.command, **at).speed, table.speed, rtol=1e-9)
    assert np.all(np.diff(table.command) > 0)


@pytest.mark.parametrize("direction", [LIFTING, LOWERING])
def test_a_table_goes_from_dead_zone_to_largest_tested_command(direction):
    table = COVERED.inverse_table(direction)
    closed, widest = (0, -1) if direction == LIFTING else (-1, 0)
    dead_zone = handmade.DEAD_ZONES[direction]
    assert (table.speed[closed], table.command[closed]) == (0.0, dead_zone)
    assert table.command[widest] == pytest.approx(dead_zone + 0.5, rel=1e-14)
    assert np.all(np.diff(table.speed) > 0)
    np.testing.assert_allclose(COVERED.speed(table.command, direction).speed, table.speed, rtol=1e-9)


def test_speeds_within_a_jump_of_the_valve_have_no_command():
    model = curved(opening=-0.2)
    table = model.inverse_table()
    # K U (−d)/(1 − d) where the valve begins to open, at a thousandth of U.
    assert table.speed[1] == pytest.approx(30 * 1.2 * (0.2 + 1e-3) / 1.2, rel=1e-9)
    with pytest.raises(
        InputError, match=r"no command gives 1 mm/s: when the valve opens, the speed is already 6\.03 mm/s"
    ):
        model.inverse_table(speeds=[1.0])


def test_what_has_no_inverse_is_refused():
    saturated = curved(saturation=0.05, exponent=3.0)
    with pytest.raises(InputError, match="no command gives 60 mm/s, since the valve saturates"):
        saturated.inverse_table(speeds=[20.0, 60.0])
    # Its tests had commands far beyond the saturation.
    far = handmade.envelope(command=(0.0, 1e4))
    flat = replace(saturated, channels={LIFTING: replace(saturated.channels[LIFTING], operating_range=far)})
    with pytest.raises(InputError, match=r"speed does not increase with the command between .* saturated"):
        flat.inverse_table()
    with pytest.raises(InputError, match="range of the test commands is not stored"):
        handmade.hitch().inverse_table(LIFTING)
    with pytest.raises(InputError, match="speeds: expected speeds ≤ 0 of lowering"):
        COVERED.inverse_table(LOWERING, [1.0])
    with pytest.raises(InputError, match="load: the lifting channel has no covariate"):
        COVERED.inverse_table(LIFTING, load=100.0)
    with pytest.raises(InputError, match="does not move at the largest command"):
        curved(opening=0.9, opening_by_pressure=0.3).inverse_table(load=180.0)


def test_a_table_is_written_with_units_over_no_file(tmp_path):
    table = COVERED.inverse_table(LOWERING)
    path = tmp_path / "tables" / "lowering.csv"
    table.to_csv(path)
    assert path.read_text().splitlines()[0] == "speed_mm_per_s,command_A"
    np.testing.assert_array_equal(
        np.loadtxt(path, delimiter=",", skiprows=1), np.stack([table.speed, table.command], axis=1)
    )
    with pytest.raises(OutputError, match="exists already"):
        table.to_csv(path)
    odd = replace(table, command_unit='a,"b')
    odd.to_csv(path, force=True)
    assert next(csv.reader(path.open())) == list(odd.columns)
    assert table.to_dataframe().columns.tolist() == ["speed_mm_per_s", "command_A"]
    assert len(repr(table).splitlines()) <= 25
