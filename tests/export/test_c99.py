"""Export to C: files, names, refusals, and what happens without a compiler."""

import json
import os
import subprocess
from dataclasses import replace

import jax.numpy as jnp
import pytest

import handmade
from hitchid.errors import InputError, OutputError
from hitchid.export import ParityError, c99, fmu, to_c, to_fmu, to_onnx, verification
from hitchid.export.c_templates import c_templates, number
from hitchid.export.constants import constants_of
from hitchid.structures import LinearStructure, Parameter, PhysicalModel


def to_fmu_of_this_machine(model, path) -> None:
    to_fmu(model, path, version="fmi3", platforms=[fmu._this_platform()])


@pytest.mark.long
@pytest.mark.parametrize("target", [to_c, to_onnx, to_fmu_of_this_machine])
def test_two_exports_are_the_same_bytes(everything, compiler, tmp_path, target) -> None:
    if target is to_onnx:
        pytest.importorskip("onnx")
    contents = []
    for folder in (tmp_path / "a", tmp_path / "b and ü"):
        target(everything, folder)
        files = sorted(folder.iterdir()) if folder.is_dir() else [folder]
        contents.append([path.read_bytes() for path in files])
    assert contents[0] == contents[1]


def test_an_export_holds_sources_and_states_its_proof(exported) -> None:
    files = {path.name: path.read_bytes() for path in exported.iterdir() if path.suffix != ".so"}
    sources = {"hitch.c", "hitch.h", "hitch_selftest.c"}
    assert set(files) == {".hitchid.json", "README.md", "hitch.py", "manifest.json", *sources}
    manifest = json.loads(files["manifest.json"])
    assert manifest["parity"]["samples"] == 2 * c99.SAMPLES
    assert manifest["memory_bytes"]["state"] < 4096
    for name in sources:
        assert files[name].isascii()
        assert b"nan" not in files[name].lower().replace(b"nan: ", b"").replace(b"for nan", b"")


@pytest.mark.parametrize("name", ["", "9lives", "a-b", "int", "_hidden", "ä", "a" * 25, "x y", "class"])
def test_what_is_no_name_and_no_precision_is_refused(everything, name: str, tmp_path) -> None:
    with pytest.raises(InputError, match="name: expected a C identifier"):
        to_c(everything, tmp_path / "out", name=name)
    with pytest.raises(InputError, match="precision"):
        to_c(everything, tmp_path / "out", precision="half")
    assert not (tmp_path / "out").exists()


@pytest.mark.long
def test_an_export_replaces_only_an_export(everything, compiler, tmp_path) -> None:
    to_c(everything, tmp_path / "out", compensators=False)
    with pytest.raises(OutputError, match="exists already"):
        to_c(everything, tmp_path / "out")
    to_c(everything, tmp_path / "out", name="lift", force=True)
    assert (tmp_path / "out" / "lift.c").exists()
    assert not (tmp_path / "out" / "hitch.c").exists()


def test_nothing_is_written_where_the_code_differs(everything, compiler, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(c99, "tolerance_of", lambda *_: verification.Tolerance(-1.0, -1.0))
    with pytest.raises(ParityError, match="nothing was written"):
        to_c(everything, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_without_a_compiler_there_are_sources_and_a_notice(everything, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(c99, "find_compiler", lambda: None)
    done = to_c(everything, tmp_path / "out")
    assert done.parity is None
    assert "not verified" in done.notices[0]
    assert "Not verified" in (tmp_path / "out" / "README.md").read_text()
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["parity"] is None


def test_a_compiler_that_fails_is_named(everything, tmp_path, monkeypatch) -> None:
    script = tmp_path / "broken cc"
    script.write_text(
        '#!/bin/sh\n[ "$1" = --version ] && echo broken 1 && exit 0\necho error: no >&2; exit 1\n'
    )
    script.chmod(0o755)
    monkeypatch.setenv("CC", f"'{script}'")
    with pytest.raises(InputError, match="cannot compile"):
        to_c(everything, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_first_working_compiler_is_taken(compiler, monkeypatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    compiler = c99.find_compiler()
    assert compiler is not None
    assert os.path.isabs(compiler.command[0])


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1e-300, 123456789.123456789, -2.0, 1e22, 0.0, 5e-324])
def test_numbers_are_written_with_all_their_digits(value: float) -> None:
    text = number(value, "double")
    assert float(text) == value
    assert "." in text or "e" in text
    single = number(value, "float")
    assert single.endswith("f")
    assert float(single[:-1]) == pytest.approx(value, rel=1e-7, abs=1.2e-38)


class Unknown(LinearStructure):
    """A structure of another package."""

    name = "unknown"
    formula = "K / s"
    parameters = (Parameter("gain", "{x}/(s·{u})", 0.01, 100.0),)

    def state_space(self, values):
        return jnp.zeros((1, 1)), values[:1]

    def transfer_function(self, values):
        return [values[0]], [1.0, 0.0]


Unknown.__module__ = "another.package"


@pytest.mark.long
def test_a_linear_structure_of_another_package_is_exported(compiler, tmp_path) -> None:
    model = handmade.hitch(modes=("lifting",), filtered=True)
    other = PhysicalModel(Unknown(), jnp.array([30.0]), jnp.asarray(0.02))
    channel = replace(model.channels["lifting"], benchmark=other)
    done = to_c(replace(model, channels={"lifting": channel}), tmp_path / "out")
    assert done.parity is not None


def test_one_with_covariates_is_refused(tmp_path) -> None:
    model = handmade.hitch_of(handmade.channel("lifting", "integrator", shape=True))
    own = model.channels["lifting"].benchmark
    other = PhysicalModel(Unknown(), own.values, own.dead_time_s, own.nonlinearity, own.scheduling)
    channel = replace(model.channels["lifting"], benchmark=other)
    with pytest.raises(InputError, match="structure unknown: expected one whose equations"):
        to_c(replace(model, channels={"lifting": channel}), tmp_path / "out")


def test_parameters_change_the_code_as_they_change_the_model(compiler, tmp_path) -> None:
    model = handmade.hitch("integrator-first-order", filtered=True)
    constants = constants_of(model)
    assert [channel.may_scale_gain for channel in constants.channels] == [True, True]
    changed = model.with_parameters(lifting={"gain": 33.0})
    state, expected = changed.init_state(100.0), []
    for _ in range(200):
        state, displacement = changed.step(state, [0.8, 0.0])
        expected.append(float(displacement))
    templates = c_templates(constants, "hitch", "mixed")
    for ending in ("c", "h"):
        (tmp_path / f"hitch.{ending}").write_text(templates.render(f"model.{ending}"))
    source = tmp_path / "main.c"
    source.write_text(
        '#include "hitch.h"\n#include <stdio.h>\n'
        "int main(void) { hitch_state s; hitch_input i = { 0.8, 0, 0, 0 }; hitch_output o; int k;\n"
        "hitch_init(&s, 100); s.parameters.lifting_gain_factor = 1.1;\n"
        'for (k = 0; k < 200; k++) { hitch_step(&s, &i, &o); printf("%.17g\\n", o.displacement); }\n'
        "return 0; }\n"
    )
    compiler.compile([source, tmp_path / "hitch.c"], tmp_path / "main")
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)  # noqa: S603
    assert [float(line) for line in done.stdout.split()] == pytest.approx(expected, rel=1e-12)
