"""One log in every form in which a user has it: file, DataFrame, record; each gives the same numbers."""

import numpy as np
import pytest

import handmade
import hitchid
from hitchid.identification.config import DEFAULT_STRUCTURES, SEARCHES, IdentificationConfig
from hitchid.logs import write_table
from truth import levels

SAMPLES = 300
MODEL = handmade.hitch()


@pytest.fixture
def log(tmp_path):
    """Return the path of a lifting log, `up.csv`."""
    up = levels(np.random.default_rng(0), SAMPLES, low=0.4)
    speed = handmade.GAINS["lifting"] * np.maximum(up - handmade.DEAD_ZONES["lifting"], 0)
    travel = handmade.STEP_S * np.concatenate([[0.0], np.cumsum(speed)[:-1]])
    time_s = np.round(handmade.STEP_S * np.arange(SAMPLES), 4)
    signals = {"current_up_A": up, "current_down_A": 0 * up, "displacement_mm": 100 + travel}
    write_table(tmp_path / "up.csv", {"time_s": time_s, **signals})
    return tmp_path / "up.csv"


def test_a_record_gives_its_signals_by_name(log):
    (record,) = hitchid.read(log)
    assert "displacement" in record
    assert "pressure" not in record
    np.testing.assert_array_equal(record["displacement"], record.displacement)
    with pytest.raises(TypeError, match="not iterable"):
        iter(record)


def test_tables_and_records_are_read_as_files_are(log):
    campaign = hitchid.read(log)
    (record,) = campaign
    frame = record.to_dataframe()
    for given in (frame, {"up": frame}, [frame], record, [record], campaign):
        (read,) = hitchid.read(given)
        np.testing.assert_array_equal(read.displacement, record.displacement)
        assert (read.kind, read.step_s) == (record.kind, record.step_s)


def test_a_log_is_simulated_from_its_path_and_its_table(log):
    (record,) = hitchid.read(log)
    run = MODEL.simulate(record)
    for given in (record.to_dataframe(), log, str(log)):
        np.testing.assert_array_equal(MODEL.simulate(given).displacement, run.displacement)
        np.testing.assert_array_equal(MODEL.predict(given, horizon=5), MODEL.predict(record, horizon=5))


def test_a_simulation_is_drawn_over_its_commands(log):
    (record,) = hitchid.read(log)
    run = MODEL.simulate(record)
    displacement, commands = run.plot()
    (curve,) = displacement.get_lines()
    np.testing.assert_array_equal(curve.get_ydata(), run.displacement)
    drawn = {line.get_label(): line.get_ydata() for line in commands.get_lines()}
    np.testing.assert_array_equal(drawn["lifting command"], record["lifting_command"])


def test_structures_and_searches_have_names():
    for name, search in SEARCHES.items():
        assert IdentificationConfig.of(search=name).search == search
    both = IdentificationConfig.of(structure="integrator").specs
    assert {spec.structure.name for spec in both.values()} == {"integrator"}
    assert IdentificationConfig.of(structure="automatic").specs == DEFAULT_STRUCTURES


def test_packages_come_with_the_first_import():
    assert hitchid.export.to_c.__module__ == "hitchid.export.c99"
