"""ONNX files of the compensators, run by onnxruntime."""

import builtins
import json

import numpy as np
import pytest

import handmade
from hitchid.errors import InputError
from hitchid.export import to_onnx

onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


def test_onnxruntime_repeats_the_compensators(everything, tmp_path) -> None:
    to_onnx(everything, tmp_path / "out", name="lift")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    for direction in ("lifting", "lowering"):
        network = onnx.load(str(tmp_path / "out" / f"lift_{direction}.onnx"))
        onnx.checker.check_model(network, full_check=True)
        assert [node.op_type for node in network.graph.node].count("LSTM") == 1
        parity = manifest["parity"][direction]
        assert parity["reads"] == 1500
        assert parity["difference"] <= 1e-6


def test_the_state_is_outside(everything, tmp_path) -> None:
    to_onnx(everything, tmp_path / "out")
    session = onnxruntime.InferenceSession(
        str(tmp_path / "out" / "hitch_lifting.onnx"), providers=["CPUExecutionProvider"]
    )
    inputs = {
        "features": np.zeros((1, 10)),
        "h": np.zeros((1, 4), np.float32),
        "c": np.zeros((1, 4), np.float32),
    }
    first = session.run(None, inputs)
    again = session.run(None, inputs)
    np.testing.assert_array_equal(first[0], again[0])
    onward = session.run(None, {**inputs, "h": first[1], "c": first[2]})
    assert onward[0] != first[0]


def test_a_model_without_compensators_is_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="has no compensator"):
        to_onnx(handmade.hitch(), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("package", ["onnx", "onnxruntime"])
def test_a_package_that_is_missing_is_named(everything, package: str, tmp_path, monkeypatch) -> None:
    real = builtins.__import__

    def without(name: str, *arguments, **keywords):
        if name == package or name.startswith(f"{package}."):
            raise ImportError(name)
        return real(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    if package == "onnx":
        with pytest.raises(InputError, match=r"pip install 'hitchid\[onnx\]'"):
            to_onnx(everything, tmp_path / "out")
    else:
        assert "not verified" in to_onnx(everything, tmp_path / "out").notices[0]
