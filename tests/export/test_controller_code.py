"""A position controller as C code: its currents, in closed loop with the model, and under bad input."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

import hitchid
from hitchid.control import ControllerFile
from hitchid.errors import InputError
from hitchid.export import to_c
from hitchid.export.controller_code import controller_files, controller_run


@pytest.fixture(
    scope="module", params=[pytest.param(False, marks=pytest.mark.long), True], ids=["linear", "shaped"]
)
def tuned(request, tmp_path_factory):
    """Return a saved model, and a controller for it."""
    from controllers import made_up_controller, made_up_model

    folder = tmp_path_factory.mktemp("model") / "model"
    hitchid.save(made_up_model(shape=request.param), folder)
    model = hitchid.load(folder)
    controller = made_up_controller(model)
    return model, ControllerFile(controller, "", model.provenance.digest, {}, model.units, {})


@pytest.mark.parametrize("precision", ["mixed", pytest.param("single", marks=pytest.mark.long)])
def test_the_code_gives_the_currents_of_the_controller(
    tuned, precision: str, compiler, warnings, tmp_path
) -> None:
    model, content = tuned
    files, difference = controller_files(content, model, "lift", precision, compiler)
    assert difference <= (1e-9 if precision == "mixed" else 1e-2)
    for name, text in files.items():
        assert text.isascii()
        (tmp_path / name).write_bytes(text)
    for language in (["-std=c99"], ["-std=c++17", "-x", "c++"]):
        assert warnings(tmp_path, *language, "lift_controller.c") == ""


def test_the_proof_moves_both_ways_holds_and_loses_measurements(tuned) -> None:
    model, content = tuned
    run = controller_run(content.controller, model)
    lifting, lowering = run.currents.T > 0
    assert lifting.mean() > 0.05
    assert lowering.mean() > 0.05
    assert not (lifting & lowering).any()
    assert (~lifting & ~lowering).mean() > 0.05
    assert np.isnan(run.inputs).any(axis=0).all()


def test_a_controller_for_another_model_is_refused(tuned) -> None:
    model, content = tuned
    with pytest.raises(InputError, match="was tuned for model 0000"):
        controller_files(replace(content, digest="0000"), model, "lift", "mixed", None)


FUZZ = r"""
#include "lift_controller.h"
#include <math.h>
static uint64_t seed = 88172645463325252u;
static uint64_t next(void) { seed ^= seed << 13; seed ^= seed >> 7; seed ^= seed << 17; return seed; }
static double odd(void)
{
    static const double values[] = {
        0, 1, 1e-310, 1e9, -1e9, 1e308, -1e308, INFINITY, -INFINITY, NAN, 100, 350
    };
    return next() % 3 ? 90 + (double)(next() % 2000000) / 1e5 : values[next() % 12];
}
int main(void)
{
    lift_controller_state state;
    lift_controller_input input;
    lift_controller_output output;
    long i;
    lift_controller_init(&state, odd());
    for (i = 0; i < 1000000; i++) {
        input.target = odd();
        input.displacement_measured = odd();
        input.measurement_valid = (int32_t)(next() % 3);
        lift_controller_step(&state, &input, &output);
        if (!(output.lifting_current >= 0 && output.lifting_current <= 5)) return 1;
        if (!(output.lowering_current >= 0 && output.lowering_current <= 5)) return 2;
        if (output.lifting_current > 0 && output.lowering_current > 0) return 3;
        if (!input.measurement_valid && output.lifting_current + output.lowering_current > 0) return 4;
        if (next() % 1000 == 0) lift_controller_init(&state, odd());
    }
    return 0;
}
"""


def test_no_input_opens_both_valves_or_breaks_a_current(tuned, compiler, tmp_path) -> None:
    model, content = tuned
    files, _ = controller_files(content, model, "lift", "mixed", None)
    for name, text in files.items():
        (tmp_path / name).write_bytes(text)
    (tmp_path / "fuzz.c").write_text(FUZZ)
    sanitizers = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    compiler.compile([tmp_path / "fuzz.c", tmp_path / "lift_controller.c"], tmp_path / "fuzz", *sanitizers)
    done = subprocess.run([tmp_path / "fuzz"], capture_output=True, text=True, check=False)  # noqa: S603
    assert done.returncode == 0, done.stderr[:1000]


def test_model_and_controller_are_written_together(tuned, compiler, tmp_path) -> None:
    model, content = tuned
    to_c(model, tmp_path / "out", name="lift", controller=content)
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"lift.c", "lift.h", "lift_controller.c", "lift_controller.h"} <= names
    load = ", 0" if model.channels["lifting"].benchmark.covariates else ""
    # The closed loop in C: a step of 10 mm settles.
    (tmp_path / "loop.c").write_text(
        '#include "lift.h"\n#include "lift_controller.h"\n'
        "int main(void)\n{\n    lift_state plant; lift_input in = { 0 }; lift_output out = { 0 };\n"
        "    lift_controller_state state; lift_controller_input to = { 110.0, 100.0, 1 };\n"
        "    lift_controller_output currents; int k;\n"
        f"    lift_init(&plant, 100.0{load});\n"
        "    lift_controller_init(&state, 100.0);\n"
        "    for (k = 0; k < 1000; k++) {\n        lift_controller_step(&state, &to, &currents);\n"
        "        in.lifting_command = currents.lifting_current;\n"
        "        in.lowering_command = currents.lowering_current;\n"
        "        lift_step(&plant, &in, &out); to.displacement_measured = out.displacement;\n    }\n"
        "    return !(out.displacement > 109.0 && out.displacement < 111.0);\n}\n"
    )
    folder = tmp_path / "out"
    sources = [tmp_path / "loop.c", folder / "lift.c", folder / "lift_controller.c"]
    compiler.compile(sources, tmp_path / "loop", f"-I{folder}")
    assert subprocess.run([tmp_path / "loop"], check=False).returncode == 0  # noqa: S603
