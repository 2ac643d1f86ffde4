"""Model folders that earlier versions wrote are read as what they were, or refused."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hitchid.data.record import LIFTING, Record
from hitchid.errors import ModelFolderError
from hitchid.model import load, load_trace, save
from hitchid.model.migration import MIGRATIONS, SCHEMA, is_readable, migrate

OLDER = Path(__file__).parent / "older"
STEP_S = 0.01
# Predictions were written with twelve digits; libraries may round a little otherwise from one to another.
DIGITS_MM = 1e-9
# Networks compute in single precision.
LSTM_DIGITS_MM = 1e-5
RECURRENT = (5, 6, 7)  # schemas of which the free run was corrected by a recurrent network


def written(schema):
    """Return the folder a version of that schema wrote, and what it predicted: command to predictions."""
    folder = OLDER / f"schema-{schema}"
    return folder, np.genfromtxt(folder / "predictions.csv", delimiter=",", names=True)


def record(rows):
    signals = {
        "displacement": rows["displacement"],
        "lifting_command": rows["lifting_command"],
        "lowering_command": 0 * rows["lifting_command"],
        "pressure": np.full(rows.size, 100.0),
    }
    units = {"displacement": "mm", "lifting_command": "A", "lowering_command": "A", "pressure": "bar"}
    return Record("t", STEP_S, signals, units, kind="lifting")


def test_every_older_schema_that_is_read_has_a_folder_its_version_wrote():
    assert {path.name for path in OLDER.iterdir()} == {f"schema-{schema}" for schema in MIGRATIONS}
    assert sorted(MIGRATIONS) == list(range(min(MIGRATIONS), SCHEMA))


# One of each kind: without and with networks, and the latest.
@pytest.mark.parametrize(
    "schema",
    [
        pytest.param(schema, marks=() if schema in (3, 5, max(MIGRATIONS)) else pytest.mark.long)
        for schema in MIGRATIONS
    ],
)
def test_an_older_model_predicts_what_it_did(schema):
    folder, rows = written(schema)
    model = load(folder)
    digits_mm = DIGITS_MM if schema < 5 else LSTM_DIGITS_MM
    if schema not in RECURRENT:
        np.testing.assert_allclose(
            model.simulate(record(rows)).displacement, rows["simulated"], rtol=0, atol=digits_mm
        )
    else:  # a recurrent network corrected the free run, which this version does not read
        assert "network correction of the free run" in model.comparison[LIFTING].dropped
    ahead = model.predict(record(rows), horizon=5)
    np.testing.assert_allclose(ahead, rows["predicted"], rtol=0, atol=digits_mm)
    assert model.drift == (0.0 if schema < 5 else 0.2)
    assert (model.two_modes is None) == (schema < 5)
    assert set(model.uncertainty) == (set() if schema < 5 else {LIFTING})
    assert load_trace(folder) == {"lifting": {"fitness": [3.0, 1.5]}}


@pytest.mark.parametrize("schema", MIGRATIONS)
def test_an_older_model_saved_again_is_of_this_version(schema, tmp_path):
    folder, rows = written(schema)
    save(load(folder), tmp_path / "model")
    assert f'"schema": {SCHEMA}' in (tmp_path / "model" / "model.json").read_text()
    again = load(tmp_path / "model")
    np.testing.assert_array_equal(
        again.simulate(record(rows)).displacement, load(folder).simulate(record(rows)).displacement
    )


@pytest.mark.parametrize("schema", MIGRATIONS)
def test_an_older_model_that_was_edited_is_refused(schema, tmp_path):
    folder, _ = written(schema)
    place = shutil.copytree(folder, tmp_path / "model")
    text = (place / "model.json").read_text()
    (place / "model.json").write_text(text.replace('"step_s": 0.01', '"step_s": 0.02'))
    with pytest.raises(ModelFolderError, match="edited"):
        load(place)


@pytest.mark.parametrize("schema", [min(MIGRATIONS) - 1, SCHEMA + 1, 0, True, "4", 4.0, None])
def test_what_no_step_leads_from_is_not_readable(schema):
    assert not is_readable(schema)


def test_what_schema_5_kept_in_the_channel_is_found_beside_it():
    folder, rows = written(5)
    model = load(folder)
    test = record(rows)
    batch = model.channels[LIFTING].batch([test])
    comparison = model.comparison[LIFTING]
    assert not comparison.baselines
    names = ("baseline arx", "baseline narx", "baseline lstm", "network correction of the free run")
    assert comparison.dropped == names
    assert comparison.covariates == ()
    samples = slice(len(test))
    paper, behind = comparison.paper, batch.with_dead_zone(comparison.paper.dead_zone)
    simulated = np.asarray(paper.simulate_benchmark(behind))[0, samples]
    np.testing.assert_allclose(simulated, rows["transfer_function_simulated"], rtol=0, atol=DIGITS_MM)
    predicted = np.asarray(paper.predict(behind, (5,)))[0, 0, samples]
    np.testing.assert_allclose(predicted, rows["paper_predicted"], rtol=0, atol=LSTM_DIGITS_MM)
    run = model.simulate(test)
    band = run.band()
    assert np.all(band.lower < run.displacement)
    assert np.all(run.displacement < band.upper)


def test_the_uncertainty_of_schema_5_keeps_its_numbers():
    model = load(written(5)[0])
    uncertainty, comparison = model.uncertainty[LIFTING], model.comparison[LIFTING]
    assert [estimate.name for estimate in uncertainty.benchmark.parameters] == ["gain", "time_constant"]
    assert comparison.paper_estimates == uncertainty.benchmark
    information = uncertainty.information
    assert (information.block_size, information.per_test_gain) == (2, True)
    assert (information.score_covariance, information.dead_zone_covariance) == (((2.0,),), ((0.01,),))
    assert [member.network for member in uncertainty.bands.ensemble] == [None]
    assert uncertainty.characteristics.speed_map[0].speed == 7.5
    (search,) = comparison.searches
    assert (search.name, search.rmse, search.evaluations) == ("multi-start", (0.5,), (60,))
    assert search.median_rmse == (None, 1.5, 0.5)
    assert model.provenance.segmentation_dead_zones == {LIFTING: 0.3}


def test_two_modes_of_schema_7_keep_their_errors_without_the_ratio_that_had_no_f_distribution():
    modes = load(written(7)[0]).two_modes
    assert (modes.needed, modes.shared_rmse, modes.two_rmse, modes.tests) == (True, 2.0, 1.0, 8)
    assert modes.difference is None
    assert modes.sentence.endswith("not tested for significance")


def test_an_offset_that_drifts_with_time_in_schema_9_is_refused():
    values = [30.0, 2.0, 0.4, 0.05, 0.3, 0.04, 0.02, 0.0]

    def content(drift):
        values[6] = drift
        channel = {"structure": "inertia-with-friction", "values": list(values)}
        channel |= dict.fromkeys(("shape", "load", "compensator"))
        others = {key: {} for key in ("comparison", "uncertainty", "set_by_hand")}
        return {"schema": 9, "channels": {LIFTING: channel}, **others}

    with pytest.raises(ValueError, match="lifting: the offset of 'inertia-with-friction' drifts with time"):
        migrate(content(0.02), {})
    assert migrate(content(0.0), {})[0]["schema"] == SCHEMA


def test_the_half_widths_of_older_bands_stay_constant():
    bands = load(written(7)[0]).uncertainty[LIFTING].bands
    movement = np.array([0.0, -3.0, 1e3])
    for horizon, row in zip((1, 10), ((0.1, 0.2, 0.3, 0.4), (1.0, 2.0, 3.0, 4.0)), strict=True):
        for level, half_width in zip(bands.levels, row, strict=True):
            np.testing.assert_allclose(bands.half_width(level, horizon, movement), half_width, rtol=1e-12)


def test_without_a_load_filter_of_schema_9_the_last_measured_error_stays():
    model, rows = load(written(8)[0]), written(8)[1]
    channel = replace(model.channels[LIFTING], compensator=None)
    batch = channel.batch([record(rows)])
    error = np.asarray(batch.displacement - channel.simulate_benchmark(batch))[0]
    (ahead,) = np.asarray(channel.predict(batch, (5,)) - channel.simulate_benchmark(batch))[:, 0]
    np.testing.assert_allclose(ahead[5:], error[:-5], rtol=0, atol=DIGITS_MM)


def test_the_load_of_schema_10_becomes_a_covariate_with_two_effects():
    model = load(written(10)[0])
    channel, known = model.channels[LIFTING], model.uncertainty[LIFTING]
    assert channel.benchmark.covariates == model.comparison[LIFTING].covariates == ("pressure",)
    named = channel.benchmark.named_values()
    assert (named["gain_by_pressure"], named["opening_by_pressure"]) == (0.3, 0.05)
    assert [estimate.name for estimate in known.benchmark.parameters] == ["gain", "gain_by_pressure"]
    (member,) = known.bands.ensemble
    assert len(member.benchmark) == channel.benchmark.parameter_vector.size
    folder, rows = written(10)
    band = load(folder).simulate(record(rows)).band()
    np.testing.assert_allclose(band.lower, rows["lower"], rtol=0, atol=LSTM_DIGITS_MM)
    np.testing.assert_allclose(band.upper, rows["upper"], rtol=0, atol=LSTM_DIGITS_MM)


def test_a_description_of_this_version_stays_as_it_is():
    content = {"schema": SCHEMA, "drift": 0.3}
    assert migrate(content, {}) == (content, {})
