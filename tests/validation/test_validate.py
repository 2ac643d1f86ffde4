"""Validation: figures by hand, on tests the identification has not seen, in the unit of the log."""

import json
from dataclasses import asdict, replace

import equinox as eqx
import numpy as np
import pytest

from handmade import DEAD_ZONES, GAINS, channel, envelope, hitch, hitch_of, with_bands
from hitchid._support.metrics import HORIZONS
from hitchid.baselines.linear import predict_ahead
from hitchid.errors import InputError, OutputError
from hitchid.logs.campaign import Campaign
from hitchid.logs.record import LIFTING, LOWERING
from hitchid.model import Provenance, SearchSummary, TwoModes, remove_padding
from hitchid.validation import compare, validate
from hitchid.validation.results import NAMES
from hitchid.validation.validate import ORIGIN_STRIDE
from truth import STEP_S, levels

SIZES = (200, 150, 180)
MODELS = hitch(compensated=True, baselines=True)


def exact(lifting, lowering, start=100.0):
    """Return the displacement the handmade integrators give, shape [N]."""
    up = GAINS[LIFTING] * np.maximum(lifting - DEAD_ZONES[LIFTING], 0)
    down = GAINS[LOWERING] * np.maximum(lowering - DEAD_ZONES[LOWERING], 0)
    return start + STEP_S * np.concatenate([[0.0], np.cumsum(up - down)[:-1]])


@pytest.fixture(scope="module")
def tests_of(make_record):
    def make(mode=LIFTING, sizes=SIZES, seed=0):
        rng, records = np.random.default_rng(seed), []
        for number, size in enumerate(sizes):
            command = levels(rng, size, low=0.4)
            commands = (command, 0 * command) if mode == LIFTING else (0 * command, command)
            # A random walk, so that no model is right, and rest where the start is found.
            wandering = np.concatenate([np.zeros(6), np.cumsum(0.05 * rng.standard_normal(size - 6))])
            records.append(make_record(exact(*commands) + wandering, *commands, name=f"{mode}-{number:02d}"))
        return records

    return make


@pytest.fixture(scope="module")
def cycle(make_record):
    def make(name, seed=0):
        rng = np.random.default_rng(seed)
        up, down = (np.concatenate([np.zeros(70), levels(rng, 130, low=0.5)]) for _ in range(2))
        lifting, lowering = np.concatenate([up, 0 * down]), np.concatenate([0 * up, down])
        noise = 0.02 * rng.standard_normal(lifting.size)
        return make_record(exact(lifting, lowering) + noise, lifting, lowering, name=name)

    return make


@pytest.fixture(scope="module")
def judged(tests_of, cycle):
    """Return tests up, two cycles, and what the validation of `MODELS` with them says."""
    tests, cycles = tests_of(), [cycle("cycle-1", 1), cycle("cycle-2", 2)]
    return tests, cycles, validate(MODELS, Campaign.of([*tests, *cycles]))


def by_hand(actual, predicted):
    """Return the figures of metrics.json for pairs of arrays, by their definitions."""
    misses = np.concatenate([p - a for a, p in zip(actual, predicted, strict=True)])
    spread = sum(float(((a - a.mean()) ** 2).sum()) for a in actual)
    lost = float((misses**2).sum())
    return {
        "rmse": np.sqrt(lost / misses.size),
        "mae": np.abs(misses).sum() / misses.size,
        "r2": 1 - lost / spread,
        "fit": 100 * (1 - np.sqrt(lost / spread)),
        "max_abs": np.abs(misses).max(),
        "within_1": np.count_nonzero(np.abs(misses) < 1) / misses.size,
        "rmse_error": jackknife([p - a for a, p in zip(actual, predicted, strict=True)]),
    }


def one_test(figures):
    """Return the figures of a single test, which says nothing of how others would scatter."""
    assert figures["rmse_error"] is None
    return {name: value for name, value in figures.items() if name != "rmse_error"}


def jackknife(misses):
    """Return the jackknife's standard error of the RMSE, each test left out once; None of a single test."""
    if len(misses) == 1:
        return None
    rest = [np.concatenate([m for k, m in enumerate(misses) if k != out]) for out in range(len(misses))]
    figures = np.array([np.sqrt(np.mean(errors**2)) for errors in rest])
    return np.sqrt((len(misses) - 1) * np.mean((figures - figures.mean()) ** 2))


def test_persistence_is_the_displacement_measured_before(judged):
    records, _, result = judged
    channel = result.metrics["channels"][LIFTING]
    measured = [record.displacement for record in records]
    expected = by_hand([y[1:] for y in measured], [y[:-1] for y in measured])
    assert channel["baselines"]["persistence"]["one_step"] == pytest.approx(expected, rel=1e-12)
    horizons = channel["horizons"]
    assert horizons["steps"] == list(HORIZONS)
    for step, error in zip(horizons["steps"], horizons["persistence"], strict=True):
        rmse = by_hand([y[step:] for y in measured], [y[:-step] for y in measured])["rmse"]
        assert error == pytest.approx(rmse, rel=1e-12)


def measuring(record):
    """Return a record with the covariate that a handmade channel with curves requires."""
    signals = {**record.signals, "pressure": np.full(len(record), 55.0)}
    return replace(record, signals=signals, units={**record.units, "pressure": "bar"})


def test_a_test_that_lacks_a_covariate_is_left_out(tests_of):
    model = hitch_of(channel(LIFTING, shape=True), channel(LOWERING))
    (bare, *others), lowering = tests_of(), tests_of(LOWERING)
    complete = [*map(measuring, others), *lowering]
    validation = validate(model, Campaign.of([bare, *complete]))
    without = validate(model, Campaign.of(complete))
    assert validation.metrics == without.metrics
    assert validation.notices == (
        "lifting-00: left out: record 'lifting-00' has no 'pressure'; the model requires this covariate",
        "1 of 6 tests left out",
        *without.notices,
    )
    compared = compare([model, hitch()], Campaign.of([bare, *complete]))
    first, second = compared
    assert first.metrics == without.metrics
    assert second.metrics["channels"][LIFTING]["tests"] == ["lifting-01", "lifting-02"]
    assert compared.notices[:2] == validation.notices[:2]
    for refused in (Campaign.of([bare]), Campaign.of([bare, *complete], strict=True)):
        with pytest.raises(InputError, match="record 'lifting-00' has no 'pressure'"):
            validate(model, refused)


@pytest.mark.parametrize("mode", [LIFTING, LOWERING])
def test_the_benchmark_runs_freely_and_from_the_last_measurement(tests_of, mode):
    records = tests_of(mode)
    channel = validate(MODELS, Campaign.of(records)).metrics["channels"][mode]
    measured = [record.displacement for record in records]
    starts = [y[:6].mean() for y in measured]
    free = [
        exact(record.command(LIFTING), record.command(LOWERING), start)
        for record, start in zip(records, starts, strict=True)
    ]
    assert channel["benchmark"]["free_run"] == pytest.approx(by_hand(measured, free), rel=1e-9)
    for step, rmse in zip(channel["horizons"]["steps"], channel["horizons"]["benchmark"], strict=True):
        anchored = [y[:-step] + f[step:] - f[:-step] for y, f in zip(measured, free, strict=True)]
        assert rmse == pytest.approx(by_hand([y[step:] for y in measured], anchored)["rmse"], rel=1e-9)


def test_the_grey_box_is_judged_by_what_it_gives(judged):
    records, _, result = judged
    channel = result.metrics["channels"][LIFTING]
    measured = [record.displacement for record in records]
    # Of a channel alone, which is in charge from the first sample and hears the hitch at rest.
    alone = replace(MODELS, channels={LIFTING: MODELS.channels[LIFTING]})
    free = [alone.simulate(record).displacement for record in map(one_way, records)]
    ahead = [alone.predict(record)[1:] for record in map(one_way, records)]
    # Tests alone and side by side: single precision of a compensator of σ = 0.02 over 200 samples.
    close = {"rel": 1e-4}
    grey = channel["greybox"]
    assert grey["free_run"] == pytest.approx(by_hand(measured, free), **close)
    assert grey["one_step"] == pytest.approx(by_hand([y[1:] for y in measured], ahead), **close)
    assert channel["horizons"]["greybox"][0] == pytest.approx(grey["one_step"]["rmse"], rel=1e-12)
    assert list(channel["per_test"]) == channel["tests"] == [record.name for record in records]
    for record, y, f in zip(records, measured, free, strict=True):
        assert one_test(channel["per_test"][record.name]["free_run"]) == pytest.approx(
            one_test(by_hand([y], [f])), **close
        )
    # The tests wander at random: no free run explains that. Both are tested whatever the model knows.
    free_run = channel["residuals"]["free_run"]
    assert not free_run["white"]
    error = np.hypot(free_run["mean"], free_run["deviation"])
    assert error == pytest.approx(grey["free_run"]["rmse"], rel=1e-6)
    assert not {"bands", "parameters"} & channel.keys()


def test_tests_of_the_identification_are_never_evaluated(tests_of):
    records = tests_of()
    seen = frozenset(record.fingerprint for record in records[:2])
    model = hitch(compensated=True, baselines=True, provenance=Provenance(seen=seen))
    renamed = [replace(record, name=f"new-{number}") for number, record in enumerate(records)]
    metres = [record.convert({"displacement": "m", "lifting_command": "mA"}) for record in renamed]
    for campaign in (records, renamed, metres):
        metrics = validate(model, Campaign.of(campaign)).metrics
        assert metrics["channels"][LIFTING]["tests"] == [campaign[2].name]
    with pytest.raises(InputError, match="was used for identification"):
        validate(model, Campaign.of(records[:2]))


def test_figures_are_in_the_unit_of_the_log(judged):
    tests, cycles, result = judged
    ours = result.metrics
    units = {"displacement": "m", "lifting_command": "mA", "lowering_command": "mA"}
    theirs = validate(MODELS, Campaign.of([record.convert(units) for record in (*tests, *cycles)])).metrics
    assert (ours["unit"], theirs["unit"]) == ("mm", "m")
    one, other = ours["channels"][LIFTING], theirs["channels"][LIFTING]
    pairs = [
        (ours["cycles"]["greybox"]["free_run"], theirs["cycles"]["greybox"]["free_run"]),
        (one["greybox"]["one_step"], other["greybox"]["one_step"]),
        (one["benchmark"]["free_run"], other["benchmark"]["free_run"]),
        (one["baselines"]["arx"]["free_run"], other["baselines"]["arx"]["free_run"]),
        (one["per_test"]["lifting-00"]["free_run"], other["per_test"]["lifting-00"]["free_run"]),
    ]
    for first, second in pairs:
        for key in ("rmse", "mae", "max_abs"):
            assert 1000 * second[key] == pytest.approx(first[key], rel=1e-4)
        assert second["r2"] == pytest.approx(first["r2"], abs=1e-4)
        # No sample is a metre off.
        assert second["within_1"] == 1.0
    np.testing.assert_allclose(
        1000 * np.array(other["horizons"]["persistence"]), one["horizons"]["persistence"], rtol=1e-9
    )


def test_errors_of_searches_are_in_the_logs_unit(tests_of):
    search = SearchSummary("whale", (10.0,), (3,), (1,), (None, 20.0, 10.0), ((1.0,),) * 3)
    compared = {LIFTING: replace(MODELS.rivals[LIFTING], searches=(search,))}
    uncertainty = with_bands(MODELS, LIFTING).uncertainty
    model = replace(MODELS, uncertainty=uncertainty, rivals=compared)
    in_cm = [record.convert({"displacement": "cm"}) for record in tests_of()]
    search = validate(model, Campaign.of(in_cm)).metrics["channels"][LIFTING]["searches"]["whale"]
    assert search["rmse"] == pytest.approx([1.0], rel=1e-12)
    assert search["median_run"]["rmse"][0] is None
    assert search["median_run"]["rmse"][1:] == pytest.approx([2.0, 1.0], rel=1e-12)


def test_cycles_are_judged_apart_in_free_run_and_over_horizons(judged):
    _, records, result = judged
    cycles = result.metrics["cycles"]
    assert cycles["tests"] == ["cycle-1", "cycle-2"]
    assert "bands" not in cycles
    measured = [record.displacement for record in records]
    free = [
        exact(record.command(LIFTING), record.command(LOWERING), record.displacement[:50].mean())
        for record in records
    ]
    assert cycles["benchmark"]["free_run"] == pytest.approx(by_hand(measured, free), rel=1e-9)
    grey = [MODELS.simulate(record).displacement for record in records]
    assert cycles["greybox"]["free_run"] == pytest.approx(by_hand(measured, grey), rel=1e-9)
    for record, y, f in zip(records, measured, grey, strict=True):
        figures = one_test(cycles["per_test"][record.name]["free_run"])
        assert figures == pytest.approx(one_test(by_hand([y], [f])), rel=1e-9)
    horizons = cycles["horizons"]
    assert horizons["steps"] == list(HORIZONS)
    for h in (1, 20):
        # One sample in so many is predicted from.
        later, before = [y[h::ORIGIN_STRIDE] for y in measured], [y[:-h][::ORIGIN_STRIDE] for y in measured]
        ahead = [MODELS.predict(record, horizon=h)[h::ORIGIN_STRIDE] for record in records]
        for model, predicted in (("greybox", ahead), ("persistence", before)):
            figures = by_hand(later, predicted)
            assert horizons[model][HORIZONS.index(h)] == pytest.approx(figures["rmse"], rel=1e-9)
            if h == 1:
                assert cycles[model]["one_step"] == pytest.approx(figures, rel=1e-9)


@pytest.mark.parametrize(("brief", "jump"), [(50, 0.0), (1, 0.01 * (30 * 0.15 + 20 * 0.25))])
def test_a_jump_is_a_step_unlike_both_its_neighbours(tests_of, make_record, brief, jump):
    lifting = np.concatenate(
        [np.zeros(50), np.full(50, 0.5), np.zeros(brief), np.full(50, 0.5), np.zeros(50)]
    )
    lowering = np.concatenate([np.zeros(100), np.full(brief, 0.5), np.zeros(50), np.full(50, 0.5)])
    # An integrator is at its new speed at once: only a stroke of one sample has no step like its own.
    for unit, factor in (("mm", 1.0), ("m", 1e-3)):
        record = make_record(exact(lifting, lowering), lifting, lowering, name="cycle")
        records = [test.convert({"displacement": unit}) for test in [*tests_of(), record]]
        max_jump = validate(hitch(), Campaign.of(records)).metrics["cycles"]["max_jump"]
        assert max_jump == pytest.approx(factor * jump, abs=1e-9 * factor)


def test_the_comparison_of_two_modes_is_told_with_its_sentence(judged):
    compared = TwoModes(needed=True, shared_rmse=2.0, two_rmse=1.0, tests=20)
    result = validate(replace(MODELS, two_modes=compared), Campaign.of(judged[0]))
    assert result.metrics["two_modes"] == asdict(compared)
    assert compared.sentence in result.notices
    assert "two_modes" not in judged[2].metrics


def test_the_tables_name_every_model_and_every_test(judged, tests_of):
    tests, cycles, result = judged
    lowering = tests_of(LOWERING)
    text = validate(MODELS, Campaign.of(lowering)).markdown() + result.markdown()
    for name in [*NAMES.values(), *(record.name for record in (*tests, *lowering, *cycles))]:
        assert f"| {name} |" in text
    baselines = {"persistence", "arx", "oe", "narx", "lstm", "transfer_function", "paper"}
    assert set(NAMES) == baselines | {"benchmark", "greybox"}


def test_every_model_has_a_figure_for_every_horizon(judged):
    channel = judged[2].metrics["channels"][LIFTING]
    horizons = channel["horizons"]
    assert set(horizons) == {"steps", *NAMES}
    assert {len(row) for row in horizons.values()} == {len(HORIZONS)}
    free_run_alone = {name for name, runs in channel["baselines"].items() if runs.keys() == {"free_run"}}
    assert free_run_alone == {"lstm", "oe", "transfer_function"}
    for name, runs in channel["baselines"].items():
        assert "free_run" in runs or name == "persistence"
        if "one_step" in runs:
            assert horizons[name][0] == runs["one_step"]["rmse"]


@pytest.mark.parametrize("name", ["arx", "narx"])
def test_an_autoregression_is_iterated_from_what_was_measured(judged, name):
    records, _, result = judged
    channel = result.metrics["channels"][LIFTING]
    measured = [record.displacement for record in records]
    travels = [y - y[:6].mean() for y in measured]
    model = MODELS.rivals[LIFTING].baselines[name]
    batch = MODELS.channels[LIFTING].batch(records)
    inputs = [row[:, : len(y)] for row, y in zip(model.inputs(batch), measured, strict=True)]
    free = [y[:6].mean() + model.simulate(u) for y, u in zip(measured, inputs, strict=True)]
    assert channel["baselines"][name]["free_run"] == pytest.approx(by_hand(measured, free), rel=1e-9)
    steps = [1, 5, 100]
    rows = [predict_ahead(model, u, w, steps) for u, w in zip(inputs, travels, strict=True)]
    for number, step in enumerate(steps):
        predicted = [y[:6].mean() + row[number] for y, row in zip(measured, rows, strict=True)]
        rmse = by_hand([y[step:] for y in measured], [p[step:] for p in predicted])["rmse"]
        assert channel["horizons"][name][HORIZONS.index(step)] == pytest.approx(rmse, rel=1e-9)


def test_the_papers_method_has_its_own_transfer_function_and_echo(judged):
    records, _, result = judged
    channel = result.metrics["channels"][LIFTING]
    paper = MODELS.rivals[LIFTING].paper
    measured = [record.displacement for record in records]
    batch = paper.batch(records)
    alone = replace(MODELS, channels={LIFTING: paper})
    for name, rows in (
        ("transfer_function", paper.simulate_benchmark(batch)),
        ("paper", paper.simulate_closed_loop(batch)),
    ):
        predicted = remove_padding(np.asarray(rows), records)
        expected = by_hand(measured, predicted)
        assert channel["baselines"][name]["free_run"] == pytest.approx(expected, rel=1e-6)
    one_step = [alone.predict(record)[1:] for record in map(one_way, records)]
    expected = by_hand([y[1:] for y in measured], one_step)
    # Tests alone and side by side, as above.
    assert channel["baselines"]["paper"]["one_step"] == pytest.approx(expected, rel=1e-4)
    assert channel["baselines"]["paper"] != channel["greybox"]


def one_way(record):
    """Return a record with its lifting command alone."""
    signals = {role: samples for role, samples in record.signals.items() if role != "lowering_command"}
    return replace(record, signals=signals)


def test_a_model_may_stand_for_the_papers_method(tests_of):
    compared = {mode: replace(own, paper=None) for mode, own in MODELS.rivals.items()}
    model = replace(MODELS, rivals=compared)
    channel = validate(model, Campaign.of(tests_of())).metrics["channels"][LIFTING]
    assert channel["baselines"]["paper"]["one_step"] == channel["greybox"]["one_step"]
    assert channel["baselines"]["transfer_function"]["free_run"] == channel["benchmark"]["free_run"]


@pytest.mark.parametrize(("ends", "outside"), [((0.0, 2.0), 0), ((0.0, 0.2), 1)], ids=["wide", "narrow"])
def test_tests_left_out_or_beyond_the_range_are_named(tests_of, ends, outside):
    covered = envelope(displacement=(-1e3, 1e3), command=ends)
    model = hitch(modes=(LIFTING,), free_run=False, covered=covered)
    result = validate(model, Campaign.of([*tests_of(), *tests_of(LOWERING)]))
    assert list(result.metrics["channels"]) == [LIFTING]
    assert any("3 lowering tests are left out" in notice for notice in result.notices)
    notice = "lifting: in 3 of 3 tests the command is outside the identified range"
    assert result.notices.count(notice) == outside


@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
def test_what_diverges_is_null_and_said_in_the_tables(tests_of, tmp_path):
    wild = eqx.tree_at(
        lambda c: c.benchmark.values,
        MODELS.channels[LIFTING],
        MODELS.channels[LIFTING].benchmark.values * 1e200,
    )
    model = replace(MODELS, channels={**MODELS.channels, LIFTING: wild})
    result = validate(model, Campaign.of(tests_of()))
    assert result.metrics["channels"][LIFTING]["benchmark"]["free_run"]["rmse"] is None
    assert "diverged" in result.markdown()
    result.write(tmp_path / "results")
    read = json.loads((tmp_path / "results" / "metrics.json").read_text())
    assert read["channels"][LIFTING]["benchmark"]["free_run"]["rmse"] is None
    assert (tmp_path / "results" / "tables.md").read_text() == result.markdown()
    with pytest.raises(OutputError, match="exists already"):
        result.write(tmp_path / "results")


def test_bands_cover_what_lies_inside_and_their_width_is_told(judged):
    records, cycles, _ = judged
    model = with_bands(MODELS, LIFTING, LOWERING)
    result = validate(model, Campaign.of([*records, *cycles]))
    bands = result.metrics["channels"][LIFTING]["bands"]
    for part, tests in ((result.metrics["cycles"]["bands"], cycles), (bands, records)):
        inside, widths = [], []
        for record in tests:
            lower, upper = model.simulate(record).band()
            inside.append(np.mean((lower <= record.displacement) & (record.displacement <= upper)))
            widths.append(upper - lower)
        assert part["free_run"]["covered"] == pytest.approx(np.mean(inside), abs=1e-12)
    assert "## cycles: band for 90 % of the samples of an unseen test" in result.markdown()
    assert bands["coverage"] == 0.9
    assert bands["free_run"]["width"] == pytest.approx(np.mean(np.concatenate(widths)), rel=1e-9)
    channel, ahead = model.channels[LIFTING], []
    for record in records:
        batch = channel.batch([record])
        predicted = np.asarray(channel.predict(batch, (1,)))[0, 0, : len(record)]
        movement = predicted[1:] - record.displacement[:-1]
        ahead.append(2 * model.uncertainty[LIFTING].bands.half_width(0.9, 1, movement))
    assert bands["horizons"]["width"][0] == pytest.approx(np.mean(np.concatenate(ahead)), rel=1e-9)
    assert bands["calibrated_on"] == {"free_run": 4, "horizons": 4}
