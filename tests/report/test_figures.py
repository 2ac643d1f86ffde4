"""The figures: what is drawn is what was given, in the width of a column, with a unit on every axis."""

import inspect
import re
import warnings
from dataclasses import replace
from textwrap import fill

import jax.numpy as jnp
import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from scipy.integrate import trapezoid

import handmade
import reported
from hitchid.logs.record import LIFTING
from hitchid.model.trace import TracedDeadZone
from hitchid.plots.style import COLOURS, COMPARED, DECIMATION_BINS, SHADES, decimate
from hitchid.report import Picture, figures
from hitchid.report.figures.identification import ONSET_FACTOR
from hitchid.report.svg import svg
from hitchid.validation import Horizons
from hitchid.validation.results import LABELS, concatenated_time
from hitchid.validation.valve_map import valve_map
from legible import assert_whole_and_apart, axis_texts, contrast, shared_label
from reported import DRAWN, PAPER, RIVALS, sketch

ZONE = TracedDeadZone(value=0.35, spread=0.01, origin="ramps", count=1)
# Counts, quantities scaled to 1, and an axis on which nothing but the order of searches is told.
WITHOUT_UNIT = {
    "iteration",
    "epoch",
    "sample, test after test",
    "loss, errors scaled to 1",
    "autocorrelation\nof errors",
    "correlation of errors\nwith command",
    "ends",
}


@pytest.fixture(autouse=True)
def _every_warning_is_an_error():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def moved(make_record, command, name):
    """Return a lifting test on which the piston follows the handmade integrator."""
    speed = handmade.GAINS[LIFTING] * np.maximum(command - handmade.DEAD_ZONES[LIFTING], 0)
    way = reported.STEP_S * np.concatenate([[0.0], np.cumsum(speed)[:-1]])
    return make_record(100 + way, command, 0 * command, name=name)


@pytest.fixture(scope="module")
def pressed(make_record):
    """Return a function that makes a lifting test of commands in A held for one second each."""
    return lambda *levels: moved(make_record, np.repeat(levels, round(1 / reported.STEP_S)), "test")


@pytest.fixture(scope="module")
def ramp(make_record):
    """Return a slow rise from 0.2 to 0.7 A."""
    return moved(make_record, np.linspace(0.2, 0.7, 1000), "ramp")


EVERY = [*DRAWN, "dead_zone", "timeline", "valve_map"]


@pytest.fixture(scope="module")
def draw(pressed, ramp):
    """Return a function that draws a figure by its name, with displacements in a unit, once."""
    kept = {}

    def fresh(name, unit):
        match name:
            case "dead_zone":
                return sketch("dead_zone", [ramp], LIFTING, ZONE, unit, "A")
            case "timeline":
                return figures.timeline(reported.mixed("odd", "even"))
            case "valve_map":
                channel = handmade.channel(LIFTING)
                return sketch("valve_map", valve_map(channel, [pressed(0, 0.5, 0, 0.6)], [ramp]), unit, "A")
        return sketch(name, *DRAWN[name](unit))

    def drawn(name, unit="mm"):
        if (name, unit) not in kept:
            # Reading the backend settles it, which is matplotlib's own doing.
            assert mpl.rcParams["backend"]
            settings = mpl.rcParams.copy()
            kept[name, unit] = fresh(name, unit)
            assert mpl.rcParams == settings
        return kept[name, unit]

    return drawn


def test_every_public_figure_is_tested_here():
    returning = {
        name
        for name, made in vars(figures).items()
        if inspect.isfunction(made) and inspect.signature(made).return_annotation in (Figure, Picture)
    }
    assert returning == {*EVERY, "timeline_picture"}


# --- what every figure keeps --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EVERY)
def test_every_axis_has_a_unit_and_whole_labels(draw, name):
    figure = draw(name)
    figure.draw_without_rendering()
    for axes in figure.axes:
        for direction, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
            assert_whole_and_apart(figure, axis_texts(axis))
            # Each axes of the intervals has a scale of its own, and its unit beside the parameter's name.
            if name == "intervals":
                continue
            label = shared_label(axes, direction)
            numbers = [text.replace("\N{MINUS SIGN}", "-") for text in ticks(axes, direction)]
            assert label or not any(re.fullmatch(r"-?[\d.]+(e[+-]?\d+)?", text) for text in numbers)
            assert not label or label in WITHOUT_UNIT or re.search(r"/\s\S", label), label
    for legend in figure.legends:
        assert_whole_and_apart(figure, legend.get_texts())


def ticks(axes, direction):
    """Return the numbers or words that are seen along one direction of an axes."""
    texts = getattr(axes, f"get_{direction}ticklabels")()
    return [text.get_text() for text in texts if text.get_visible() and text.get_text()]


UNITED = [
    name
    for name in EVERY
    if name not in ("intervals", "loads", "losses", "residual_correlations", "coverage", "timeline")
]


@pytest.mark.parametrize("name", UNITED)
def test_the_unit_on_an_axis_is_the_one_given(draw, name):
    def labels(unit):
        return [text for axes in draw(name, unit).axes for text in (axes.get_xlabel(), axes.get_ylabel())]

    angles, lengths = labels("deg"), labels("mm")
    assert [text.replace("deg", "mm") for text in angles] == lengths
    assert angles != lengths


def colours(axes):
    """Return what the legend of an axes calls its lines, to their colours, `free run` left out."""
    by_name = {}
    for line in axes.get_lines():
        name = line.get_label().partition(", free")[0]
        if not name.startswith("_"):
            by_name.setdefault(name, set()).add(line.get_color())
    return by_name


def test_a_model_has_one_colour_in_all_figures(draw):
    by_test = draw("errors_by_test").axes[0]
    rows = [text.get_text() for text in by_test.get_yticklabels()]
    points = [line for line in by_test.get_lines() if line.get_marker() not in ("|", "None")]
    by_figure = [
        {row: {line.get_color()} for row, line in zip(rows, points, strict=True)},
        *(colours(draw(name).axes[0]) for name in ("horizons", "outputs", "error_distribution")),
    ]
    assert {"grey box", "physics model", "grey box, one step", "ARX"} <= set().union(*by_figure)
    for name in set().union(*by_figure):
        assert len(set().union(*(figure_colours.get(name, set()) for figure_colours in by_figure))) == 1, name


COMPARED_ERRORS = {"persistence": (1.0, 2.0), **dict.fromkeys(COMPARED, (1.0, 2.0))}


@pytest.mark.parametrize("errors", [reported.horizons(), Horizons((1, 2), COMPARED_ERRORS)])
def test_no_two_models_look_alike_even_without_colours(errors):
    lines = sketch("horizons", errors, reported.STEP_S, "mm").axes[0].get_lines()
    assert len(lines) == len(errors.rmse)
    assert len({line.get_marker() for line in lines}) == len(lines)
    assert len({(line.get_color(), str(line._dash_pattern)) for line in lines}) == len(lines)
    if len(errors.rmse) == len(COMPARED_ERRORS):
        dashes = {str(line._dash_pattern) for line in lines}
        assert len(dashes) == len(COMPARED)  # persistence is solid, as A
        assert len({line.get_color() for line in lines}) == len(lines)


def test_every_drawn_model_has_a_name_and_a_palette_colour():
    assert set(LABELS) <= set(COLOURS)
    assert set(COLOURS.values()) == {shade.light for shade in SHADES.values()}


@pytest.mark.parametrize("name", [name for name in SHADES if name not in ("grid", "hold")])
def test_a_curve_stands_out_from_paper_and_dark_screens(name):
    light, dark, screen = (
        tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
        for colour in (SHADES[name].light, SHADES[name].dark, "#16161a")
    )
    # 3 is what WCAG 2.2 asks of graphics; Okabe and Ito's yellow and pink keep 2.1 on white.
    assert contrast(light, (255, 255, 255)) >= 2.1
    assert contrast(dark, screen) >= 4.5


# --- each figure by its data --------------------------------------------------------------------------------


def test_convergence_shows_fitness_and_parameters_as_they_were_found():
    trace = reported.trace()
    fitness, *parameters = sketch("convergence", trace.phase1, "mm").axes
    phase1 = trace.phase1
    np.testing.assert_array_equal(fitness.lines[0].get_xdata(), np.arange(1, 21))
    np.testing.assert_array_equal(fitness.lines[0].get_ydata(), [np.nan, *phase1.fitness[1:]])
    for number, (axes, parameter) in enumerate(zip(parameters, phase1.parameters, strict=True)):
        best, polished = axes.lines
        np.testing.assert_array_equal(best.get_ydata(), [row[number] for row in phase1.values])
        assert set(polished.get_ydata()) == {parameter.value}
        assert axes.get_ylabel() == f"{parameter.symbol}\n/ {parameter.unit}"
    # A parameter without a symbol is called by its name.
    unnamed = reported.trace(reported.estimate("speed_along", symbol="", unit="1/mm", linear=True))
    assert sketch("convergence", unnamed.phase1, "mm").axes[1].get_ylabel() == "speed along\n/ 1/mm"


@pytest.mark.parametrize(
    "horizons", [reported.horizons(), Horizons((1, 2), {"greybox": (1.0, None), "persistence": (1.0, 2.0)})]
)
def test_horizons_show_errors_where_a_model_did_not_diverge(horizons):
    lines = sketch("horizons", horizons, 0.02, "mm").axes[0].get_lines()
    for line, errors in zip(lines, horizons.rmse.values(), strict=True):
        np.testing.assert_array_equal(line.get_xdata(), 0.02 * np.array(horizons.steps))
        np.testing.assert_array_equal(line.get_ydata(), np.array(errors, dtype=float))


@pytest.mark.parametrize("sizes", [(300,), (200, 200, 200)])
def test_each_test_is_a_point_and_the_bar_their_rms(sizes):
    tests = reported.predictions(sizes)
    axes = sketch("errors_by_test", tests, "mm", RIVALS).axes[0]
    points, bars = axes.get_lines()[::2], axes.get_lines()[1::2]
    for number, (model, point, bar) in enumerate(zip(RIVALS, points, bars, strict=True)):
        errors = [
            np.linalg.norm(a - p) / np.sqrt(a.size)
            for a, p in zip(tests.actual, tests.models[model], strict=True)
        ]
        np.testing.assert_allclose(point.get_xdata(), errors, rtol=1e-12)
        assert set(point.get_ydata()) == {number}
        together = np.linalg.norm(errors) / np.sqrt(len(errors))
        np.testing.assert_allclose(bar.get_xdata(), [together], rtol=1e-12)


def test_a_distribution_shows_the_shares_of_995_of_1000_samples():
    rng = np.random.default_rng(4)
    rows = {"one_step": 0.1 + rng.standard_normal(4000), "free_run": rng.standard_t(3, 3000)}
    above, below = sketch("error_distribution", rows, "mm").axes
    reach = below.get_xlim()[1]
    assert above.get_xlim() == (-reach, reach)
    shares = [np.mean(np.abs(errors) <= reach) for errors in rows.values()]
    assert min(shares) == pytest.approx(0.995, abs=1 / 3000)
    bars = np.array_split(np.array([(p.get_width(), p.get_height()) for p in above.patches]), len(rows))
    for line, errors, share, bar in zip(below.get_lines(), rows.values(), shares, bars, strict=True):
        limit, cumulative = line.get_data()
        counted = 100 * np.mean(np.abs(errors)[:, None] <= limit, axis=0)
        # A quantile lies between two samples, so the share of those below it is off by one of them at most.
        np.testing.assert_allclose(cumulative, counted, rtol=0, atol=100 * 1.01 / errors.size)
        # The area of the histogram.
        assert bar.prod(axis=1).sum() == pytest.approx(share, rel=1e-9)


def test_the_bell_has_the_errors_mean_spread_and_unit_area():
    errors = 2.0 + 0.25 * np.random.default_rng(0).standard_normal(5000)
    wide = np.concatenate([errors, 8.0 - errors, np.repeat([-40.0, 40.0], 50)])
    above, _ = sketch("error_distribution", {"free_run": errors, "benchmark": wide}, "mm").axes
    error, bell = above.get_lines()[0].get_data()
    # The far end of the axes lies over 100 spreads away; steps of 0.4 to 0.8 spreads leave the rule exact.
    assert above.get_xlim()[1] == pytest.approx(40)
    step = error[1] - error[0]
    assert step < 2 * errors.std()
    assert trapezoid(bell, error) == pytest.approx(1.0, abs=1e-2)
    assert trapezoid(error * bell, error) == pytest.approx(errors.mean(), abs=1e-2)


def test_outputs_show_each_test_with_its_extremes():
    tests = reported.predictions((2000, 1500, 1800))
    above, below = sketch("outputs", tests, "mm", PAPER).axes
    drawn = {"measured": tests.actual} | {LABELS[name]: tests.models[name] for name in PAPER}
    lines = {line.get_label(): line for line in above.get_lines()}
    assert set(lines) == set(drawn)
    starts = np.cumsum([0.0, *(time_s[-1] for time_s in tests.time_s)])
    for label, rows in drawn.items():
        time_s, values = lines[label].get_data()
        assert values.size <= 2 * DECIMATION_BINS + len(rows)
        for row, start, stop in zip(rows, starts, starts[1:], strict=False):
            inside = values[(time_s > start) & (time_s <= stop)]
            assert np.nanmin(inside) == pytest.approx(row[1:].min())
            assert np.nanmax(inside) == pytest.approx(row[1:].max())
        assert np.isnan(values).sum() == len(rows)
    errors = tests.actual[2] - tests.models["free_run"][2]
    drawn_errors = next(line for line in below.get_lines() if line.get_color() == COLOURS["free_run"])
    last = drawn_errors.get_ydata()[drawn_errors.get_xdata() > starts[2]]
    assert np.nanmax(np.abs(last)) == pytest.approx(np.abs(errors[1:]).max())


def test_the_band_is_filled_around_displacement_and_errors():
    tests = reported.predictions((300,))
    drawn = sketch("outputs", tests, "mm", PAPER).axes
    for axes, middle in zip(drawn, (tests.models["free_run"][0], 0), strict=True):
        (filled,) = axes.collections
        corners = np.concatenate([path.vertices for path in filled.get_paths()])
        around = corners[:, 1] - np.interp(corners[:, 0], tests.time_s[0], np.broadcast_to(middle, 300))
        np.testing.assert_allclose(np.abs(around), 2.0, atol=1e-9)


def test_predicted_errors_show_what_the_benchmark_misses():
    tests = reported.predictions((200, 150))
    actual, predicted = sketch("predicted_errors", {"validation": tests}, "mm").axes[0].get_lines()

    def joined(model):
        rows = zip(tests.models[model] if model else tests.actual, tests.models["benchmark"], strict=True)
        return np.concatenate([[np.nan, *(one - other)[1:]] for one, other in rows])

    np.testing.assert_array_equal(actual.get_ydata(), joined(None))
    np.testing.assert_array_equal(predicted.get_ydata(), joined("one_step"))


def test_time_goes_on_from_test_to_test():
    tests = reported.predictions((3, 4, 2))
    steps = [0, 1, 2, 2, 3, 4, 5, 5, 6]
    np.testing.assert_allclose(concatenated_time(tests), 0.01 * np.array(steps), rtol=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.81, 1.0])
def test_coverage_shows_shares_in_percent_over_seconds_within_its_axes(share):
    axes = sketch("coverage", reported.bands(covered=share, ahead=1 - share), 0.02).axes[0]
    ahead, free, nominal = axes.get_lines()
    np.testing.assert_allclose(ahead.get_xdata(), 0.02 * np.array(reported.STEPS))
    np.testing.assert_allclose(ahead.get_ydata(), 100 * (1 - share))
    assert {*free.get_ydata()} == {100 * share}
    assert {*nominal.get_ydata()} == {90}
    low, high = axes.get_ylim()
    for line in axes.get_lines():
        assert low <= min(line.get_ydata())
        assert max(line.get_ydata()) <= high


def test_correlations_show_what_was_found_and_its_bounds():
    tested = reported.residuals()
    above, below = sketch("residual_correlations", tested).axes
    for axes, name, bound in (
        (above, "autocorrelation", "autocorrelation_bounds"),
        (below, "cross_correlation", "cross_bounds"),
    ):
        band, stems = axes.collections
        ends = [segment[1, 1] for segment in stems.get_segments()]
        np.testing.assert_allclose(ends, getattr(tested, name))
        assert band.get_paths()[0].vertices[:, 1].max() == pytest.approx(max(getattr(tested, bound)))
        assert axes.get_ylim()[1] > max(np.abs(ends))
    np.testing.assert_allclose(
        [segment[0, 0] for segment in below.collections[1].get_segments()],
        reported.STEP_S * np.array(tested.cross_lags),
    )


def test_places_show_mean_and_spread_of_errors_in_each_bin():
    tested = reported.residuals()
    drawn = sketch("residuals_by_variable", tested, "mm", "A").axes
    for axes, name in zip(drawn, ("position", "speed", "command"), strict=True):
        bins = tested.by_quantity[name].bins
        spreads, means = axes.get_lines()[0:-1:2], axes.get_lines()[1:-1:2]
        assert len(spreads) == len(means) == len(bins)
        for errors, spread, mean in zip(bins, spreads, means, strict=True):
            assert set(mean.get_ydata()) == {errors.mean}
            low, high = spread.get_ydata()
            assert (low + high) / 2 == pytest.approx(errors.mean)
            # Mean square = mean² + variance.
            assert ((high - low) / 2) ** 2 + errors.mean**2 == pytest.approx(errors.rmse**2)


def test_searches_show_every_end_and_the_run_in_the_middle():
    summaries = reported.searches()
    went, ended = sketch("searches", summaries, "mm").axes
    for line, points, search in zip(went.get_lines(), ended.get_lines(), summaries, strict=True):
        np.testing.assert_array_equal(line.get_ydata()[1:], search.median_rmse[1:])
        assert (line.get_xdata()[0], line.get_xdata()[-1]) == (0, 100)
        assert list(points.get_ydata()) == [end for end in search.rmse if end is not None]


def test_losses_show_both_parts_and_the_epoch_that_is_kept():
    trace = reported.trace().phase2
    training, validation, kept = sketch("losses", trace).axes[0].get_lines()
    np.testing.assert_array_equal(training.get_ydata()[1:], trace.training_loss[1:])
    np.testing.assert_array_equal(validation.get_ydata(), trace.validation_loss)
    assert validation.get_xdata()[0] == 1
    assert set(kept.get_xdata()) == {trace.best_epoch}


def test_structures_show_both_errors_in_the_order_that_was_given():
    candidates = reported.trace(candidates=4).candidates
    axes = sketch("structures", candidates, "mm", None).axes[0]
    by_place = sorted(zip(axes.get_yticks(), (t.get_text() for t in axes.get_yticklabels()), strict=True))
    names = [f"{candidate.name}{' (chosen)' if candidate.chosen else ''}" for candidate in candidates]
    assert [text for _, text in by_place[::-1]] == [fill(name, 24) for name in names]
    everywhere, held_out = axes.get_lines()
    np.testing.assert_array_equal(everywhere.get_xdata(), [candidate.rmse for candidate in candidates])
    np.testing.assert_array_equal(
        held_out.get_xdata(), [np.nan, *(candidate.held_out_rmse for candidate in candidates[1:])]
    )


# --- intervals ----------------------------------------------------------------------------------------------


def marks(axes):
    return [line.get_marker() for line in axes.get_lines() if line.get_marker() not in ("None", None, "")]


def test_an_interval_has_both_ends_or_arrows():
    estimates = reported.ESTIMATES
    for axes, estimate in zip(sketch("intervals", "title", estimates).axes, estimates, strict=True):
        bar = axes.get_lines()[0].get_xdata()
        edge = axes.get_xlim()
        ends = [
            edge_end if end is None else end for edge_end, end in zip(edge, estimate.interval, strict=True)
        ]
        np.testing.assert_allclose(bar, ends)
        arrows = [sign for sign, end in zip("<>", estimate.interval, strict=True) if end is None]
        assert marks(axes) == [*arrows, "|"]
        assert edge[0] < estimate.value < edge[1]
        unit = "" if estimate.unit == "1" else f" / {estimate.unit}"
        assert axes.get_ylabel() == f"{estimate.symbol}{unit}"


def test_an_undetermined_parameter_shows_its_value_on_a_grey_interval():
    wide = reported.estimate(determined=False, interval=(2.0, 700.0), verdict="not determined")
    (axes,) = sketch("intervals", "title", [wide]).axes
    assert marks(axes) == ["|"]
    assert axes.get_lines()[0].get_color() == COLOURS["faint"] != COLOURS["benchmark"]


@pytest.mark.parametrize("interval", [(-0.2, 0.3), (0.0, 0.3), (None, 0.1), (-0.2, None), (0.0, 0.0)])
def test_an_interval_around_zero_is_drawn_on_a_plain_scale(interval):
    around = reported.estimate("shape", unit="1", value=0.0, linear=True, lower=-1.0, interval=interval)
    (axes,) = sketch("intervals", "title", [around]).axes
    assert axes.get_xscale() == "linear"
    assert axes.get_xlim()[0] < 0.0 < axes.get_xlim()[1]


@pytest.mark.parametrize("value", [1e-4, 0.08, 1.0, 30.0, 1e5])
def test_an_interval_has_distinct_numbers_along_its_scale(value):
    for error in (0.003 * value, 0.03 * value, 0.3 * value):
        figure = sketch("intervals", "title", [reported.estimate(value=value, error=error)])
        figure.draw_without_rendering()
        shown = ticks(figure.axes[0], "x")
        assert len(shown) >= 2
        assert len(set(shown)) == len(shown)


# --- the valve ----------------------------------------------------------------------------------------------


def test_the_valve_map_has_the_benchmarks_gain_and_dead_zone(pressed, ramp):
    channel = handmade.channel(LIFTING)
    test = pressed(*[0.4, 0.5, 0.6] * 8)
    axes = sketch("valve_map", valve_map(channel, [test], [ramp]), "mm", "A").axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    zone, gain = handmade.DEAD_ZONES[LIFTING], handmade.GAINS[LIFTING]

    def steady(command):
        return gain * np.maximum(command - zone, 0)

    command, speed = lines["benchmark"].get_data()
    # Numbers of the model are double, the kernel of the travel is single: seven digits.
    np.testing.assert_allclose(speed, steady(command), atol=1e-4)
    assert set(lines["dead zone"].get_xdata()) == {zone}
    command, speed = lines["ramps"].get_data()
    # Half a second of the ramp spans 0.025 A; where it bends, the mean slope is off by a quarter of that.
    np.testing.assert_allclose(speed, steady(command), atol=gain * 0.025 / 4)
    points = [line for line in axes.get_lines() if line.get_marker() == "o" and len(line.get_xdata()) == 1]
    assert points
    for point in points:
        (command_shown,), (middle,) = point.get_data()
        assert middle == pytest.approx(steady(command_shown), abs=1e-6)


def test_the_valve_map_waits_until_a_slow_speed_has_settled(make_record):
    # K/(s (τ s + 1)) with a lag of 1 s: after 0.25 s a command has moved the speed by 22 % of its change.
    lag_s, held = 1.0, round(5.0 / reported.STEP_S)
    slow = handmade.channel(LIFTING, "integrator-first-order")
    vector = jnp.array([handmade.GAINS[LIFTING], lag_s, 0.0])
    slow = replace(slow, benchmark=slow.benchmark.with_parameter_vector(vector))
    command = np.repeat([0.4, 0.5, 0.6, 0.45] * 2, held)
    settled = handmade.GAINS[LIFTING] * (command - handmade.DEAD_ZONES[LIFTING])
    decay, speed = np.exp(-reported.STEP_S / lag_s), np.zeros(command.size)
    for index in range(1, command.size):
        speed[index] = settled[index - 1] + decay * (speed[index - 1] - settled[index - 1])
    test = make_record(100 + reported.STEP_S * np.cumsum(speed), command, 0 * command)
    bins = valve_map(slow, [test], []).bins
    assert len(bins) == 1
    # Four lags leave exp(−4) of the largest change of the speed, 0.2 A, and of the first rise, 0.25 A.
    expected = handmade.GAINS[LIFTING] * (bins[0].command - handmade.DEAD_ZONES[LIFTING])
    assert bins[0].middle == pytest.approx(expected, abs=handmade.GAINS[LIFTING] * 0.25 * np.exp(-3.8))


def test_the_speed_map_shows_bands_and_points_of_each_load():
    described = reported.characteristics()
    axes = sketch("speed_map", described).axes[0]
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert set(lines) == {"90", "120", "150", "measured", "dead zone"}
    assert set(lines["dead zone"].get_xdata()) == {described.dead_zone.value}
    for load, band in zip((90.0, 120.0, 150.0), axes.collections, strict=True):
        points = [point for point in described.speed_map if point.load == load]
        drawn = np.column_stack(lines[f"{load:g}"].get_data())
        np.testing.assert_array_equal(drawn, [(point.command, point.speed) for point in points])
        corners = {tuple(corner) for path in band.get_paths() for corner in path.vertices}
        highest = axes.get_ylim()[1]
        for point in points:
            lower, upper = point.interval
            assert {(point.command, lower), (point.command, highest if upper is None else upper)} <= corners
    measured = np.column_stack(lines["measured"].get_data())
    np.testing.assert_array_equal(measured, [(point.command, point.speed) for point in described.measured])


def test_the_valve_map_needs_no_ramp_and_no_standing_command(make_record):
    command = 0.4 + 0.1 * np.sin(np.arange(200))
    moving = make_record(100 + np.arange(200.0), command, 0 * command)
    axes = sketch("valve_map", valve_map(handmade.channel(LIFTING), [moving], []), "mm", "A").axes[0]
    labels = {line.get_label() for line in axes.get_lines()}
    assert {"benchmark", "dead zone"} <= labels
    assert not {"ramps", "tests"} & labels


def test_a_ramp_is_drawn_up_to_where_motion_is_plain(ramp):
    axes = sketch("dead_zone", [ramp], LIFTING, ZONE, "mm", "A").axes[0]
    way, value = axes.get_lines()
    assert set(value.get_xdata()) == {0.35}
    command, moved = way.get_data()
    assert command.max() <= ONSET_FACTOR * 0.35
    assert moved[command < 0.35].max() == 0
    assert np.interp(0.5, command, moved) == pytest.approx(
        np.interp(0.5, ramp.command(LIFTING), ramp.displacement - 100), abs=0.05
    )
    (spread,) = axes.patches
    assert (spread.get_x(), spread.get_x() + spread.get_width()) == pytest.approx((0.34, 0.36))
    # A dead zone of one ramp has no spread.
    alone = sketch("dead_zone", [ramp], LIFTING, replace(ZONE, spread=None), "mm", "A")
    assert not alone.axes[0].patches


# --- what is not there, or not finite -----------------------------------------------------------------------


def with_errors(value, model="free_run", sizes=(300, 250)):
    """Return tests on which a model goes off to some value halfway."""
    tests = reported.predictions(sizes)
    rows = tuple(np.where(np.arange(y.size) > y.size // 2, value, y) for y in tests.models[model])
    return replace(tests, models={**tests.models, model: rows})


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
@pytest.mark.parametrize("sizes", [(300, 250), (3000,)])
def test_a_model_that_diverged_is_drawn_without_a_warning(value, sizes):
    tests = with_errors(value, sizes=sizes)
    for figure in (
        sketch("outputs", tests, "mm", PAPER),
        sketch("errors_by_test", tests, "mm", RIVALS),
        sketch("predicted_errors", {"test": with_errors(value, "one_step", sizes)}, "mm"),
    ):
        assert svg(figure)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200])
def test_a_distribution_leaves_the_errors_of_what_diverged_out(value):
    tests = with_errors(value)
    rows = {name: tests.errors(name) for name in ("free_run", "benchmark")}
    above, below = sketch("error_distribution", rows, "mm").axes
    alone, _ = sketch("error_distribution", {"benchmark": rows["benchmark"]}, "mm").axes
    assert above.get_xlim() == alone.get_xlim()
    assert sum(len(line.get_xdata()) > 0 for line in below.get_lines()) == 1
    assert svg(sketch("error_distribution", {"free_run": rows["free_run"]}, "mm"))


SPEEDS, (WHALE, *OTHERS) = reported.characteristics(), reported.searches()
ENDLESS = replace(WHALE, rmse=(None,) * 3, median_rmse=(None,), median_values=())
SPARSE = {
    "one level": ("speed_map", replace(SPEEDS, speed_map=SPEEDS.speed_map[:1], measured=())),
    "one test": ("outputs", reported.predictions((30,), band=False), "mm", PAPER),
    "one model": ("errors_by_test", reported.predictions((30,)), "mm", ["free_run"]),
    "constant errors": ("error_distribution", {"free_run": np.full(100, 0.1)}, "mm"),
    "errors of zero": ("error_distribution", {"free_run": np.zeros(100)}, "mm"),
    "one error": ("error_distribution", {"free_run": np.ones(1)}, "mm"),
    "one horizon": ("horizons", Horizons((1,), {"greybox": (0.1,)}), 0.01, "mm"),
    "one parameter": ("intervals", "title", [reported.estimate()]),
    "no finite fitness": ("convergence", replace(reported.trace().phase1, fitness=(None,) * 20), "mm"),
    "a search without an end": ("searches", [ENDLESS, *OTHERS], "mm"),
    "one candidate": ("structures", reported.trace(candidates=1).candidates, "mm", None),
    "two epochs": ("losses", reported.trace(iterations=2).phase2),
    "errors that stand": ("residual_correlations", reported.residuals(level=0.1)),
    "no errors": ("residual_correlations", reported.residuals(level=0.0)),
    "errors that stand by place": ("residuals_by_variable", reported.residuals(level=0.1), "mm", "A"),
}


@pytest.mark.parametrize("drawn", SPARSE.values(), ids=SPARSE.keys())
def test_little_is_drawn_without_a_warning(drawn):
    assert "<svg" in svg(sketch(*drawn))


def test_errors_that_do_not_spread_are_still_in_the_legend():
    figure = sketch("error_distribution", {"free_run": np.full(9, 0.1), "one_step": np.arange(9.0)}, "mm")
    assert len(figure.legends[0].get_texts()) == 2


# --- thinned curves -----------------------------------------------------------------------------------------

VALUES = st.lists(
    st.one_of(st.floats(-1e6, 1e6), st.just(float("nan")), st.integers(-3, 3).map(float)),
    max_size=40,
)


@given(values=VALUES, repeats=st.integers(1, 120), seed=st.integers(0, 99))
def test_a_thinned_curve_keeps_extremes_gaps_and_order(values, repeats, seed):
    whole = np.random.default_rng(seed).permutation(np.repeat(np.array(values, dtype=float), repeats))
    sample = np.arange(whole.size)
    at, kept = decimate(sample, whole)
    assert np.all(np.diff(at) > 0)
    np.testing.assert_array_equal(kept, whole[at])
    gaps = np.isnan(whole)
    assert np.isnan(kept).sum() == gaps.sum()
    assert at.size <= 2 * DECIMATION_BINS + gaps.sum()
    if not gaps.all():
        assert (np.nanmin(kept), np.nanmax(kept)) == (np.nanmin(whole), np.nanmax(whole))


@given(samples=st.integers(700, 5000), seed=st.integers(0, 99))
def test_a_thinned_curve_lies_nowhere_far_from_the_whole(samples, seed):
    walk = np.cumsum(np.random.default_rng(seed).standard_normal(samples))
    at, kept = decimate(np.arange(samples), walk)
    # Between two points that are kept lie two stretches of samples at most, whose spread bounds the miss.
    reach = 2 * -(-samples // DECIMATION_BINS)
    for k in np.random.default_rng(seed).integers(at[0], at[-1], 20):
        near = walk[max(0, k - reach) : k + reach + 1]
        assert near.min() <= np.interp(k, at, kept) <= near.max()
