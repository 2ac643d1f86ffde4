"""A model folder comes back exactly, or is refused with one kind of error."""

import json
import os
import shutil
from datetime import UTC, datetime
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file

from handmade import hitch
from hitchid._support.files import canonical_json, digest
from hitchid.errors import ModelFolderError, OutputError
from hitchid.logs.record import LIFTING
from hitchid.model import Provenance, load, save

FILES = ("model.json", "weights.safetensors", "trace.json", "rivals.json", "rivals.safetensors")
PROVENANCE = Provenance(
    identification={LIFTING: ("a", "b")},
    validation={LIFTING: ("b",)},
    held_out={LIFTING: ("c",)},
    seen=frozenset({"0f", "1e"}),
    segmentation_dead_zones={LIFTING: 0.1},
    seed=3,
    settings={"structure": {"lifting": {"bounds": {"gain": [1e-05, 1.0]}}}},
    versions={"hitchid": "0.1.0"},
)


def whole():
    return hitch(compensated=True, baselines=True, free_run=True, provenance=PROVENANCE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("models") / "model"
    save(whole(), place, trace={"lifting": {"fitness": [3.0, 1.5]}})
    return place


def parts(model):
    """Return every array of a model, of what is deployed and of what it is compared with."""
    compared = {mode: (dict(each.baselines), each.paper) for mode, each in model.rivals.items()}
    return dict(model.channels), compared


@pytest.mark.parametrize(
    "model",
    [
        hitch("integrator-second-order", compensated=True, baselines=True, provenance=PROVENANCE),
        hitch("first-order-lag", modes=(LIFTING,), end_stop=120.5, dead_time_s=0.037),
        hitch("integrator-first-order", compensated=True),
        hitch("integrator", baselines=True),
        hitch("integrator", shape=True),
        hitch("integrator", free_run=True),
        hitch("integrator", compensated=True, baselines=True, free_run=True, shape=True),
    ],
    ids=["trained", "one-channel", "compensator", "baselines", "shape", "free-run", "everything"],
)
def test_a_model_comes_back_as_it_was(model, tmp_path):
    save(model, tmp_path / "model")
    back = load(tmp_path / "model")
    ours_all, theirs_all = parts(back), parts(model)
    assert jax.tree.structure(ours_all) == jax.tree.structure(theirs_all)
    for ours, theirs in zip(jax.tree.leaves(ours_all), jax.tree.leaves(theirs_all), strict=True):
        assert type(ours) is type(theirs)
        assert np.asarray(ours).dtype == np.asarray(theirs).dtype
        np.testing.assert_array_equal(ours, theirs)
    assert (back.step_s, dict(back.units)) == (model.step_s, dict(model.units))
    assert back.provenance == model.provenance


def test_a_model_with_every_part_simulates_and_predicts_as_before(tmp_path, make_record):
    options = {"compensated": True, "baselines": True, "free_run": True, "dead_time_s": 0.037}
    model = hitch("integrator-second-order", provenance=PROVENANCE, **options)
    save(model, tmp_path / "model")
    back = load(tmp_path / "model")
    up, down = np.repeat([0, 0.9, 0, 0], 60), np.repeat([0, 0, 0, 0.6], 60)
    record = make_record(np.linspace(80.0, 90.0, 240), up, down)
    np.testing.assert_array_equal(back.simulate(record).displacement, model.simulate(record).displacement)
    np.testing.assert_array_equal(back.predict(record, horizon=3), model.predict(record, horizon=3))
    uncompensated = model.simulate(record, compensated=False)
    assert np.abs(model.simulate(record).displacement - uncompensated).max() > 0.1
    for mode, channel in model.channels.items():
        ours, theirs = back.rivals[mode], model.rivals[mode]
        batch = channel.batch([record])
        for name, fitted in theirs.baselines.items():
            with jax.enable_x64(True):
                rows = ours.baselines[name].free_run(batch), fitted.free_run(batch)
            np.testing.assert_array_equal(*rows)
        np.testing.assert_array_equal(
            ours.paper.simulate_closed_loop(batch), theirs.paper.simulate_closed_loop(batch)
        )
    assert back.simulate(record).flags == model.simulate(record).flags != ()


def test_saving_twice_gives_the_same_bytes(folder, tmp_path):
    save(load(folder), tmp_path / "again", trace={"lifting": {"fitness": [3.0, 1.5]}})
    assert sorted(path.name for path in folder.iterdir()) == sorted([".hitchid.json", *FILES])
    for name in FILES:
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


def test_a_loaded_model_tells_the_name_of_its_folder_and_the_day_it_was_written(folder, tmp_path):
    place = tmp_path / "arm-7"
    shutil.copytree(folder, place)
    written = datetime(2025, 3, 31, 23, 59, 59, tzinfo=UTC).timestamp()
    os.utime(place / "model.json", (written, written))
    provenance = load(place).provenance
    assert (provenance.name, provenance.date) == ("arm-7", "2025-03-31")
    # Neither is part of the model: a copy is the same one, byte by byte once saved.
    assert provenance == load(folder).provenance
    save(load(place), tmp_path / "again", trace={"lifting": {"fitness": [3.0, 1.5]}})
    assert (tmp_path / "again" / "model.json").read_bytes() == (folder / "model.json").read_bytes()


def test_a_caller_in_single_precision_gets_the_model_in_double(folder):
    with jax.enable_x64(False):
        back = load(folder)
    assert back.channels[LIFTING].benchmark.values.dtype == np.float64
    np.testing.assert_array_equal(
        back.channels[LIFTING].benchmark.values, whole().channels[LIFTING].benchmark.values
    )


def refused(folder, place, name, data):
    """Assert that the folder with other bytes in one of its files is refused as the house refuses."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(folder, place)
    (place / name).write_bytes(data)
    with pytest.raises(ModelFolderError, match=name):
        load(place)


sampled = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.mark.parametrize("name", FILES)
@sampled
@given(where=st.floats(0, 1, exclude_max=True), flip=st.integers(1, 255))
def test_every_changed_byte_is_noticed(folder, tmp_path, name, where, flip):
    data = bytearray((folder / name).read_bytes())
    data[int(where * len(data))] ^= flip
    refused(folder, tmp_path / "edited", name, bytes(data))


def test_even_a_space_instead_of_a_line_break_is_noticed(folder, tmp_path):
    data = (folder / "model.json").read_bytes()
    refused(folder, tmp_path / "edited", "model.json", data.replace(b"\n", b" ", 1))


@pytest.mark.parametrize("name", FILES)
@sampled
@given(where=st.floats(0, 1, exclude_max=True))
@example(where=0.0)
@example(where=1 - 2**-53)
def test_every_cut_is_noticed(folder, tmp_path, name, where):
    data = (folder / name).read_bytes()
    refused(folder, tmp_path / "cut", name, data[: int(where * len(data))])


@pytest.mark.parametrize("name", sorted({*FILES} - {"rivals.json"}))
def test_a_missing_file_is_named(folder, tmp_path, name):
    shutil.copytree(folder, tmp_path / "model")
    (tmp_path / "model" / name).unlink()
    with pytest.raises(ModelFolderError, match=f"{name}: cannot be read"):
        load(tmp_path / "model")
    with pytest.raises(ModelFolderError, match="cannot be read"):
        load(tmp_path / "nowhere")


@pytest.mark.parametrize("number", ["1e999", "NaN", "-Infinity", '"\\ud800"'])
def test_an_edited_number_is_noticed_even_where_it_is_none(folder, tmp_path, number):
    edited = (folder / "model.json").read_text().replace('"step_s": 0.01', f'"step_s": {number}')
    refused(folder, tmp_path / "edited", "model.json", edited.encode())


@pytest.mark.parametrize("content", ["[]", "null", "3", '"hitchid model"', "{}", "[" * 10])
def test_json_that_describes_no_model_is_refused(folder, tmp_path, content):
    refused(folder, tmp_path / "edited", "model.json", content.encode())


def redescribed(folder, place, change, name="model.json"):
    """Return a copy of the folder with another description, whose own digest is right."""
    shutil.copytree(folder, place)
    content = json.loads((place / name).read_bytes())
    del content["digest"]
    change(content)
    content["digest"] = digest(canonical_json(content))
    (place / name).write_bytes(canonical_json(content))
    return place


@pytest.mark.parametrize(
    "key", ["files", "channels", "step_s", "units", "split", "seen", "cut_at", "seed", "settings", "versions"]
)
def test_a_description_without_one_of_its_parts_is_refused(folder, tmp_path, key):
    place = redescribed(folder, tmp_path / "model", lambda content: content.pop(key))
    with pytest.raises(ModelFolderError):
        load(place)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("structure", "triple-integrator"),
        ("values", [1.0, 2.0, 3.0]),
        ("values", "many"),
        ("direction", None),
    ],
)
def test_a_channel_that_cannot_be_is_refused(folder, tmp_path, key, value):
    def change(content):
        content["channels"]["lifting"][key] = value

    with pytest.raises(ModelFolderError):
        load(redescribed(folder, tmp_path / "model", change))


def test_a_baseline_that_no_package_has_is_refused_by_name(folder, tmp_path):
    def change(content):
        content["rivals"]["lifting"]["baselines"].append("oracle")

    with pytest.raises(ModelFolderError, match="oracle"):
        load(redescribed(folder, tmp_path / "model", change, "rivals.json"))


def test_rivals_of_another_model_are_refused(folder, tmp_path):
    def change(content):
        content["model"] = "0" * 64

    with pytest.raises(ModelFolderError, match="belongs to another model"):
        load(redescribed(folder, tmp_path / "model", change, "rivals.json"))


def test_a_model_without_its_rivals_is_the_same_model(folder, tmp_path):
    place = tmp_path / "model"
    shutil.copytree(folder, place)
    (place / "rivals.json").unlink()
    assert load(place).rivals == {}
    assert load(place).provenance.digest == load(folder).provenance.digest


@pytest.mark.parametrize("schema", [12, 14, True, "13", 13.0, None])
def test_another_schema_is_refused(folder, tmp_path, schema):
    def change(content):
        content["schema"] = schema

    with pytest.raises(ModelFolderError, match=f"schema {schema!r}, expected 13.*identify again"):
        load(redescribed(folder, tmp_path / "model", change))


def test_the_weights_hold_only_what_is_deployed(folder):
    deployed, compared = (set(load_file(folder / name)) for name in (FILES[1], FILES[4]))
    assert {name.split("/")[1] for name in deployed} == {
        "compensator",
        "speed_compensator",
        "operating_range",
        "load_filter",
    }
    assert {name.split("/")[1] for name in compared} == {"baselines", "paper"}


@pytest.mark.parametrize(
    ("part", "key", "size"),
    [
        ("compensator", "hidden", 5),
        ("speed_compensator", "units", 5),
        ("speed_compensator", "members", 3),
    ],
)
def test_a_part_of_another_size_than_its_weights_is_refused(folder, tmp_path, part, key, size):
    def change(content):
        content["channels"]["lifting"][part][key] = size

    with pytest.raises(ModelFolderError, match="shape"):
        load(redescribed(folder, tmp_path / "model", change))


def test_what_stands_there_is_not_replaced_unless_it_is_a_model_and_force_is_given(folder, tmp_path):
    place = tmp_path / "model"
    shutil.copytree(folder, place)
    with pytest.raises(OutputError, match="exists already"):
        save(whole(), place)
    save(hitch(), place, force=True)
    assert load(place).channels[LIFTING].compensator is None
    (tmp_path / "file").write_text("mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "mine.txt").write_text("mine")
    for name in ("file", "other"):
        for force in (False, True):
            with pytest.raises(OutputError):
                save(hitch(), tmp_path / name, force=force)
    assert (tmp_path / "file").read_text() == (tmp_path / "other" / "mine.txt").read_text() == "mine"
    (tmp_path / "empty").mkdir()
    save(hitch(), tmp_path / "empty")


@pytest.mark.parametrize("method", ["write_bytes", "rename"])
@pytest.mark.parametrize("there", [False, True])
def test_a_failed_write_leaves_everything_as_it_was(folder, tmp_path, monkeypatch, method, there):
    place = tmp_path / "models" / "model"
    place.parent.mkdir()
    if there:
        shutil.copytree(folder, place)
    inner = getattr(Path, method)

    def full(self, *args):
        if method == "rename" or self.name == "trace.json":
            raise OSError(28, "No space left on device")
        return inner(self, *args)

    with monkeypatch.context() as patch:
        patch.setattr(Path, method, full)
        with pytest.raises(OutputError, match="No space left on device"):
            save(hitch(), place, force=there)
    assert [path.name for path in place.parent.iterdir()] == (["model"] if there else [])
    if there:
        assert load(place).channels[LIFTING].compensator is not None
