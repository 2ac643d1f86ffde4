"""Export of the compensators for predictions to ONNX: one LSTM node each, its state outside."""

from pathlib import Path
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from hitchid._support import checks
from hitchid._support.files import canonical_json, check_folder, write_files, write_folder
from hitchid._support.jax_setup import installed_versions
from hitchid._support.precision import double_precision
from hitchid.errors import InputError
from hitchid.export.c99 import MANIFEST, Export, check_name
from hitchid.export.verification import ParityError
from hitchid.model import Hitch
from hitchid.networks import COMPENSATOR_FEATURES, Compensator, LstmState

if TYPE_CHECKING:
    import onnx

OPSET = 17  # the first with everything that current runtimes ask for; LSTM itself is of 14
READS = 1500  # compared with the model
TOLERANCE = 1e-6  # of the output in its spread: single precision, summed in another order
GATES = (0, 3, 1, 2)  # input, output, forget, cell in ONNX; input, forget, cell, output here


@checks.named_arguments
@double_precision
def to_onnx(model: Hitch, folder: str | Path, *, name: str = "hitch", force: bool = False) -> Export:
    """Write the compensators for predictions as ONNX, `NAME_DIRECTION.onnx` for each channel that has one.

    Inputs: `features`, float64 [1, 10], in the order of Sun et al. 2025, sec. 2.2.3, in the model's units;
    `h` and `c`, float32 [1, H]. Outputs: `innovation`, float32 [1], in the displacement's unit; `h_next` and
    `c_next`. The state starts at zero; of two states, started a window apart, the older gives the prediction,
    as `CompensatorState` documents. The whole model, with filter and physics, is in the C export, not here.

    Args:
        model: the model.
        folder: folder to write.
        name: prefix of the files, a C identifier.
        force: replace an earlier export.

    Raises:
        InputError: the package onnx is not installed, or the model has no such compensator.
        ParityError: onnxruntime computes something else than the model.
        OutputError: the folder exists, or cannot be written.
    """
    out = checks.path(folder, "folder")
    checks.instance(model, Hitch, "model", "a model as hitchid.load returns it")
    check_name(name)
    check_folder(out, result_kind=MANIFEST, force=force)
    networks = {
        direction: channel.compensator
        for direction, channel in model.channels.items()
        if channel.compensator is not None
    }
    if not networks:
        raise InputError("model: has no compensator for predictions; expected one to export; use --to c")
    files, parities, notices = {}, {}, []
    for direction, compensator in networks.items():
        content = _network(compensator, f"{name}_{direction}").SerializeToString()
        files[f"{name}_{direction}.onnx"] = content
        parities[direction] = _verify(content, compensator)
        if parities[direction] is None:
            notices = ["not verified: run pip install onnxruntime and export again"]
    files[MANIFEST] = canonical_json(
        {
            "target": "onnx",
            "model": model.provenance.digest,
            "versions": {"hitchid": installed_versions()["hitchid"]},
            "features": list(COMPENSATOR_FEATURES),
            "window": {direction: network.window for direction, network in networks.items()},
            "step_s": model.step_s,
            "units": dict(model.units),
            "parity": parities,
        }
    )
    write_folder(out, lambda target: write_files(target, files), result_kind=MANIFEST, force=force)
    return Export(out, None, "", tuple(notices))


def _network(compensator: Compensator, name: str) -> "onnx.ModelProto":
    """Return the graph of a compensator: (x − centre)/spread, in double, → LSTM, in single → σ (w h + b)."""
    try:
        from onnx import TensorProto, checker, helper, numpy_helper
    except ImportError as error:
        raise InputError("onnx: expected it to be installed; run: pip install 'hitchid[onnx]'") from error
    cell, size = compensator.network.cell, compensator.network.cell.hidden_size

    def reordered(weights: object) -> np.ndarray:
        parts = np.split(np.asarray(weights, np.float32), 4, axis=0)
        return np.concatenate([parts[gate] for gate in GATES], axis=0)

    output = float(compensator.error_step)
    constants = {
        "centre": np.asarray(compensator.centre, np.float64),
        "spread": np.asarray(compensator.spread, np.float64),
        "W": reordered(cell.weight_ih)[None],
        "R": reordered(cell.weight_hh)[None],
        "B": np.concatenate([reordered(cell.bias), np.zeros(4 * size, np.float32)])[None],
        "weights": (output * np.asarray(compensator.network.head.weight, np.float64).T).astype(np.float32),
        "bias": np.array([output * float(np.asarray(compensator.network.head.bias)[0])], np.float32),
        "sequence": np.array([0]),
        "last": np.array([1]),
    }
    lstm_inputs = ["x", "W", "R", "B", "", "h_0", "c_0"]
    nodes = [
        helper.make_node("Sub", ["features", "centre"], ["shifted"]),
        helper.make_node("Div", ["shifted", "spread"], ["scaled_double"]),
        helper.make_node("Cast", ["scaled_double"], ["scaled"], to=TensorProto.FLOAT),
        helper.make_node("Unsqueeze", ["scaled", "sequence"], ["x"]),
        helper.make_node("Unsqueeze", ["h", "sequence"], ["h_0"]),
        helper.make_node("Unsqueeze", ["c", "sequence"], ["c_0"]),
        helper.make_node("LSTM", lstm_inputs, ["", "h_1", "c_1"], hidden_size=size),
        helper.make_node("Squeeze", ["h_1", "sequence"], ["h_next"]),
        helper.make_node("Squeeze", ["c_1", "sequence"], ["c_next"]),
        helper.make_node("MatMul", ["h_next", "weights"], ["product"]),
        helper.make_node("Add", ["product", "bias"], ["column"]),
        helper.make_node("Squeeze", ["column", "last"], ["innovation"]),
    ]
    features = helper.make_tensor_value_info("features", TensorProto.DOUBLE, [1, len(COMPENSATOR_FEATURES)])
    inputs, outputs = (
        [helper.make_tensor_value_info(key, TensorProto.FLOAT, [1, size]) for key in keys]
        for keys in (("h", "c"), ("h_next", "c_next"))
    )
    graph = helper.make_graph(
        nodes,
        name,
        [features, *inputs],
        [helper.make_tensor_value_info("innovation", TensorProto.FLOAT, [1]), *outputs],
        [numpy_helper.from_array(array, key) for key, array in constants.items()],
    )
    network = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid("", OPSET)],
        producer_name="hitchid",
        producer_version=installed_versions()["hitchid"],
    )
    network.ir_version = 8  # of opset 17; onnxruntime refuses a newer one than its own
    checker.check_model(network)
    return network


def _verify(content: bytes, compensator: Compensator) -> dict[str, float] | None:
    """Return the largest difference of onnxruntime in spreads of the output; None where it is not there."""
    try:
        import onnxruntime
    except ImportError:
        return None
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(0)
    inputs = np.asarray(compensator.centre) + np.asarray(compensator.spread) * rng.standard_normal(
        (READS, len(COMPENSATOR_FEATURES))
    )
    hidden: LstmState = compensator.network.zero_state(())
    size = compensator.network.cell.hidden_size
    state = [np.zeros((1, size), np.float32)] * 2
    outputs, expected = [], []
    for row in inputs:
        hidden = compensator.network.step(hidden, compensator.scale(jnp.asarray(row)))
        expected.append(float(compensator.error_step) * float(compensator.network.output(hidden)))
        output, *state = session.run(
            ["innovation", "h_next", "c_next"], {"features": row[None], "h": state[0], "c": state[1]}
        )
        outputs.append(np.asarray(output).item())
    # In spreads: the innovation is in the displacement's unit, whatever that is.
    spread = abs(float(compensator.error_step)) or 1.0
    difference = float(np.max(np.abs(np.array(outputs) - np.array(expected)))) / spread
    if not difference <= TOLERANCE * max(1.0, float(np.max(np.abs(expected))) / spread):
        raise ParityError(f"the ONNX file differs from the compensator by {difference:.2g} of its spread")
    return {"difference": difference, "reads": READS}
