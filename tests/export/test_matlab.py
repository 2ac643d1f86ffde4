"""Functions of MATLAB and Octave against the model's own step, and what they say of themselves."""

import json
import re
import subprocess
from dataclasses import replace

import pytest

import hitchid
from controllers import made_up_controller, made_up_model
from hitchid.control import ControllerFile
from hitchid.errors import InputError
from hitchid.export import matlab, to_matlab
from hitchid.export.controller_code import controller_files
from hitchid.export.verification import ParityError
from hostile import STRINGS


@pytest.fixture(scope="session")
def octave():
    """Return a function that runs lines of Octave in a folder and returns what they print."""
    program = matlab.find_octave()
    if program is None:
        pytest.skip("octave-cli is not installed; it runs the exported functions")

    def run(folder, *lines):
        (folder / "lines_of_the_test.m").write_text("\n".join(lines) + "\n")
        command = [program.program, *matlab.OPTIONS, "lines_of_the_test.m"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603
        assert done.stderr == ""
        return done.stdout

    return run


@pytest.mark.long
def test_functions_repeat_the_model(model, octave, tmp_path):
    parity = to_matlab(model, tmp_path / "out").parity
    assert parity.samples == 6000
    assert parity.modes == 0
    assert max(parity.measured, parity.free_run) <= 1e-9


def test_every_function_is_called_without_a_warning(everything, octave, tmp_path):
    folder = tmp_path / "with ü and spaces"
    to_matlab(everything, folder)
    said = octave(
        folder,
        "model = hitch(); systems = hitch_tf();",
        "printf('%.17g\\n', model.lifting.dead_zone, model.step_s, hitch_demo());",
        "printf('%.17g\\n', numel(systems.lifting.den));",
        "wanted = 0.5 * model.lifting.inverse.flow(end);",
        "command = interp1(model.lifting.inverse.flow, model.lifting.inverse.command, wanted);",
        "flow = interp1(model.lifting.valve.command, model.lifting.valve.flow, command);",
        "printf('%.17g\\n', flow - wanted);",
    )
    dead_zone, step_s, difference, order, inverse = map(float, said.split())
    assert dead_zone == everything.channels["lifting"].dead_zone
    assert step_s == everything.step_s
    assert difference <= 1e-9 * 100  # the tests of the hand-made models cover 100 mm
    assert order >= 2
    assert abs(inverse) < 1e-12
    for path in folder.glob("*.m"):
        assert not re.search(r"\b(eval|evalin|feval|global|assignin)\b", path.read_text())


@pytest.mark.long
def test_texts_of_a_strangers_model_stay_texts(everything, octave, tmp_path):
    units = {role: f"mm'); system('touch {tmp_path / 'reached'}'); %{{\n{text}" for role, text in
             zip(everything.units, STRINGS, strict=False)}  # fmt: skip
    stranger = replace(everything, units={**everything.units, **units})
    to_matlab(stranger, tmp_path / "out")
    octave(tmp_path / "out", "model = hitch(); hitch_tf(); difference = hitch_demo();")
    plain = to_matlab(everything, tmp_path / "plain").place
    for path in plain.glob("*.m"):
        # But for what is said of units, the same code.
        own, other = (_instructions(folder / path.name) for folder in (plain, tmp_path / "out"))
        assert own == other
    assert not (tmp_path / "reached").exists()


def _instructions(path):
    """Return the lines of a function without comments and texts."""
    lines = (re.sub(r"'[^']*'|%.*", "", line).strip() for line in path.read_text().splitlines())
    return [line for line in lines if line]


@pytest.mark.long
def test_the_controller_gives_the_currents_of_the_c_code(octave, compiler, tmp_path):
    saved = tmp_path / "model"
    hitchid.save(made_up_model(shape=True), saved)
    model = hitchid.load(saved)
    content = ControllerFile(made_up_controller(model), "", model.provenance.digest, {}, model.units, {})
    to_matlab(model, tmp_path / "out", controller=content)
    stated = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert stated["controller"]["current_difference"] <= 1e-9
    _, of_c = controller_files(content, model, "hitch", "double", compiler)
    assert of_c <= 1e-9


@pytest.mark.long
def test_nothing_is_written_where_the_functions_differ(everything, octave, tmp_path, monkeypatch):
    monkeypatch.setattr(matlab, "PARITY", 1e-30)
    with pytest.raises(ParityError, match="differs from the model"):
        to_matlab(everything, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_without_octave_there_are_functions_and_a_notice(everything, tmp_path, monkeypatch):
    monkeypatch.setattr(matlab, "find_octave", lambda: None)
    done = to_matlab(everything, tmp_path / "out")
    assert done.notices == (matlab.UNVERIFIED,)
    assert json.loads((tmp_path / "out" / "manifest.json").read_text())["parity"] is None
    assert "Not verified" in (tmp_path / "out" / "README.md").read_text()


@pytest.mark.parametrize("name", ["end", "exp", "9lives", "a b", "hitch;system('ls')"])
def test_what_is_no_name_of_a_function_is_refused(everything, name, tmp_path):
    with pytest.raises(InputError, match="name"):
        to_matlab(everything, tmp_path / "out", name=name)
