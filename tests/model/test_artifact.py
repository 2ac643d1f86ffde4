"""A model folder comes back exactly, or is refused with one kind of error."""

import json
import os
import shutil
from datetime import UTC, datetime

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


TRACE = {"lifting": {"fitness": [3.0, 1.5]}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    saved = tmp_path_factory.mktemp("models") / "model"
    save(whole(), saved, trace=TRACE)
    return saved


def parts(model):
    """Return every array of a model, of what is deployed and of what it is compared with."""
    compared = {mode: (dict(fitted.baselines), fitted.paper) for mode, fitted in model.rivals.items()}
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


def test_saving_twice_gives_the_same_bytes(folder, tmp_path):
    save(load(folder), tmp_path / "again", trace=TRACE)
    assert sorted(path.name for path in folder.iterdir()) == sorted([".hitchid.json", *FILES])
    for name in FILES:
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


def test_a_loaded_model_has_its_folders_name_and_date(folder, tmp_path):
    copied = shutil.copytree(folder, tmp_path / "arm-7")
    written = datetime(2025, 3, 31, 23, 59, 59, tzinfo=UTC).timestamp()
    os.utime(copied / "model.json", (written, written))
    provenance = load(copied).provenance
    assert (provenance.name, provenance.date) == ("arm-7", "2025-03-31")
    # Neither is part of the model: a copy is the same one, byte by byte once saved.
    assert provenance == load(folder).provenance
    save(load(copied), tmp_path / "again", trace=TRACE)
    assert (tmp_path / "again" / "model.json").read_bytes() == (folder / "model.json").read_bytes()


def assert_refused(folder, copied, name, data):
    """Assert that the folder with other bytes in one of its files is refused by the name of the file."""
    shutil.rmtree(copied, ignore_errors=True)
    shutil.copytree(folder, copied)
    (copied / name).write_bytes(data)
    with pytest.raises(ModelFolderError, match=name):
        load(copied)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(FILES),
    where=st.floats(0, 1, exclude_max=True),
    flip=st.one_of(st.none(), st.integers(1, 255)),
)
@example(name=FILES[0], where=0.0, flip=None)
@example(name=FILES[1], where=1 - 2**-53, flip=None)
def test_every_changed_byte_and_every_cut_is_noticed(folder, tmp_path, name, where, flip):
    data = bytearray((folder / name).read_bytes())
    at = int(where * len(data))
    if flip is None:
        del data[at:]
    else:
        data[at] ^= flip
    assert_refused(folder, tmp_path / "edited", name, bytes(data))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\n", " "),
        *(('"step_s": 0.01', f'"step_s": {number}') for number in ("1e999", "NaN", "-Infinity", '"\\ud800"')),
        *((None, content) for content in ("[]", "null", "3", '"hitchid model"', "{}", "[" * 10)),
    ],
)
def test_a_description_edited_by_hand_is_refused_whatever_it_says(folder, tmp_path, old, new):
    text = (folder / "model.json").read_text()
    edited = new if old is None else text.replace(old, new, 1)
    assert_refused(folder, tmp_path / "edited", "model.json", edited.encode())


def test_a_missing_file_is_named(folder, tmp_path):
    for name in sorted({*FILES} - {"rivals.json"}):
        copied = shutil.copytree(folder, tmp_path / name)
        (copied / name).unlink()
        with pytest.raises(ModelFolderError, match=f"{name}: cannot be read"):
            load(copied)
    with pytest.raises(ModelFolderError, match="cannot be read"):
        load(tmp_path / "nowhere")


MISSING = object()
CHANNEL = ("channels", "lifting")
PARTS = ("files", "channels", "step_s", "units", "split", "seen", "cut_at", "seed", "settings", "versions")


@pytest.mark.parametrize(
    ("name", "keys", "value", "message"),
    [
        *(("model.json", (key,), MISSING, "model.json") for key in PARTS),
        ("model.json", (*CHANNEL, "structure"), "triple-integrator", "model.json"),
        ("model.json", (*CHANNEL, "values"), [1.0, 2.0, 3.0], "model.json"),
        ("model.json", (*CHANNEL, "values"), "many", "model.json"),
        ("model.json", (*CHANNEL, "direction"), None, "model.json"),
        # A part of another size than its weights.
        ("model.json", (*CHANNEL, "compensator", "hidden"), 5, "shape"),
        ("model.json", (*CHANNEL, "speed_compensator", "units"), 5, "shape"),
        ("model.json", (*CHANNEL, "speed_compensator", "members"), 3, "shape"),
        *(
            ("model.json", ("schema",), schema, f"schema {schema!r}, expected 14.*identify again")
            for schema in (13, 15, True, "14", 14.0, None)
        ),
        ("rivals.json", ("rivals", "lifting", "baselines"), ["arx", "oracle"], "oracle"),
        ("rivals.json", ("model",), "0" * 64, "belongs to another model"),
    ],
)
def test_a_description_of_no_model_is_refused_despite_its_digest(
    folder, tmp_path, name, keys, value, message
):
    copied = shutil.copytree(folder, tmp_path / "model")
    content = json.loads((copied / name).read_bytes())
    del content["digest"]
    part = content
    for key in keys[:-1]:
        part = part[key]
    if value is MISSING:
        del part[keys[-1]]
    else:
        part[keys[-1]] = value
    content["digest"] = digest(canonical_json(content))
    (copied / name).write_bytes(canonical_json(content))
    with pytest.raises(ModelFolderError, match=message):
        load(copied)


def test_a_model_without_its_rivals_is_the_same_model(folder, tmp_path):
    copied = shutil.copytree(folder, tmp_path / "model")
    (copied / "rivals.json").unlink()
    assert load(copied).rivals == {}
    assert load(copied).provenance.digest == load(folder).provenance.digest


def test_the_weights_hold_only_what_is_deployed(folder):
    deployed, compared = (
        {name.split("/")[1] for name in load_file(folder / file)} for file in (FILES[1], FILES[4])
    )
    assert deployed == {"compensator", "speed_compensator", "operating_range", "load_filter"}
    assert compared == {"baselines", "paper"}


def test_only_a_model_is_replaced_and_only_by_force(folder, tmp_path):
    copied = shutil.copytree(folder, tmp_path / "model")
    with pytest.raises(OutputError, match="exists already"):
        save(whole(), copied)
    save(hitch(), copied, force=True)
    assert load(copied).channels[LIFTING].compensator is None
