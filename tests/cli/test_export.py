"""`hitchid export`: every target, refusals with exit code 2 and one line, nothing half written."""

import json

import pytest
from commands import hitchid

import handmade
from hitchid.model import save


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Return the folder of a model."""
    folder = tmp_path_factory.mktemp("export") / "model with ü"
    save(handmade.hitch("integrator-first-order", compensated=True, filtered=True), folder)
    return folder


def run(*arguments) -> tuple[int, str]:
    """Return exit code and output, of a refusal what it says."""
    result = hitchid("export", *arguments)
    return result.code, result.err if result.code == 2 else result.out


def test_c_is_written_with_its_differences_as_json(model, tmp_path) -> None:
    arguments = (model, "--to", "c", "--out", tmp_path / "code")
    code, printed = run(*arguments, "--no-compensators", "--json")
    assert code == 0, printed
    content = json.loads(printed)
    assert content["parity"] is None or content["parity"]["measured"] <= 1e-12
    assert "lstm" not in (tmp_path / "code" / "hitch.c").read_text().lower()
    again, message = run(*arguments)
    assert again == 2
    assert "exists already" in message


@pytest.mark.parametrize(
    ("target", "options"),
    [
        pytest.param("fmu2", ("--platforms", "linux64"), marks=pytest.mark.long),
        pytest.param("fmu3", ("--platforms", "linux64"), marks=pytest.mark.long),
        ("onnx", ()),
    ],
)
def test_every_other_target_is_written(model, target: str, options, tmp_path) -> None:
    pytest.importorskip("onnx")
    code, printed = run(model, "--to", target, "--out", tmp_path / "a.fmu", *options)
    assert code == 0, printed
    assert "export:" in printed
    assert (tmp_path / "a.fmu").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--to", "simulink", "--out", "x"), "simulink"),
        (("--to", "fmu2", "--out", "x.fmu", "--platforms", "atari"), "platform"),
        (("--to", "c", "--out", "x", "--name", "3d"), "C identifier"),
        (("--to", "c", "--out", "x", "--precision", "half"), "half"),
    ],
)
def test_what_cannot_be_is_refused_with_exit_code_2(
    model, arguments, words: str, tmp_path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, message = run(model, *arguments)
    assert code == 2
    assert words in message
    assert not list(tmp_path.iterdir())


def test_a_damaged_model_is_refused(model, tmp_path) -> None:
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    for path in model.iterdir():
        (damaged / path.name).write_bytes(path.read_bytes()[:-10])
    code, message = run(damaged, "--to", "c", "--out", tmp_path / "code")
    assert code == 2
    assert "damaged" in message
    assert not (tmp_path / "code").exists()


def test_the_model_itself_is_not_replaced(model) -> None:
    code, message = run(model, "--to", "c", "--out", model, "--force")
    assert code == 2
    assert "contains the input" in message
