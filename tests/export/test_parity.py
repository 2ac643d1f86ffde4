"""Generated C code against the model's own step: every structure, every option, every precision."""

import numpy as np
import pytest

from hitchid.export.c99 import REPLAY, verified_source
from hitchid.export.c_templates import c_templates
from hitchid.export.constants import constants_of
from hitchid.export.verification import ROUNDING, compare, replay

pytestmark = pytest.mark.usefixtures("compiler")
SAMPLES = 3000


def test_code_repeats_the_model(model) -> None:
    verified = verified_source(model, "hitch", precision="mixed", compensators=True, samples=SAMPLES)
    free, measured = verified.runs
    assert np.isfinite(free.displacement).all()
    assert np.isfinite(measured.displacement).all()
    assert np.ptp(free.displacement) > 0.02 * verified.travel_range  # it moves
    assert set(free.mode) >= set(range(2)) or len(model.channels) == 1
    assert verified.parity.modes == 0
    # Without networks a rounding each sample; with them a millionth and ten millionths of 250 mm.
    limits = (1e-12, 1e-10) if verified.constants.error_steps is None else (4e-9, 4e-8)
    assert verified.parity.measured <= limits[0]
    assert verified.parity.free_run <= limits[1]


@pytest.mark.parametrize("precision", ["double", "single"])
def test_other_precisions_repeat_the_model(everything, precision: str) -> None:
    parity = verified_source(everything, "hitch", precision=precision, compensators=True).parity
    assert parity.measured <= (4e-9 if precision == "double" else ROUNDING[precision][0])
    assert parity.free_run <= (4e-8 if precision == "double" else ROUNDING[precision][1])


@pytest.mark.long
def test_optimisation_changes_nothing_beyond_rounding(everything, compiler, tmp_path) -> None:
    verified = verified_source(everything, "hitch", precision="mixed", compensators=False)
    for name, text in verified.files.items():
        (tmp_path / name).write_text(text)
    for level in ("-O0", "-O3"):
        program = tmp_path / f"replay{level}"
        compiler.compile([tmp_path / "hitch.c", tmp_path / REPLAY], program, level)
        rows = tuple(replay([str(program)], run, tmp_path) for run in verified.runs)
        parity = compare(verified.runs, rows, verified.travel_range)
        assert parity.modes == 0
        assert parity.measured <= ROUNDING["mixed"][0]
        assert parity.free_run <= ROUNDING["mixed"][1]


def test_the_band_is_that_of_the_model(everything, compiler, tmp_path) -> None:
    verified = verified_source(everything, "hitch", precision="mixed", compensators=True)
    run = verified.runs[1]
    first = int(np.flatnonzero(np.isfinite(run.inputs[:, -1]))[0])
    program = tmp_path / "replay"
    for name, text in verified.files.items():
        (tmp_path / name).write_text(text)
    compiler.compile([tmp_path / "hitch.c", tmp_path / REPLAY], program)
    rows = replay([str(program)], run, tmp_path)
    assert (rows[:first, 3] < 0).all()
    # One sample ahead of a measured displacement, beside the model's own half width.
    at = np.flatnonzero(np.isfinite(run.inputs[:, -1]) & (run.mode >= 0))[:200]
    bands = [everything.uncertainty[name].bands for name in everything.channels]
    expected = [
        float(bands[run.mode[k]].half_width(0.9, 1, np.array(run.displacement[k] - run.inputs[k, -1])))
        for k in at
    ]
    np.testing.assert_allclose(rows[at, 3], expected, rtol=1e-6)


def write_sources(model, precision: str, folder) -> None:
    """Write the generated code of a model."""
    templates = c_templates(constants_of(model), "hitch", precision)
    (folder / "hitch.h").write_text(templates.render("model.h"))
    (folder / "hitch.c").write_text(templates.render("model.c"))
    (folder / REPLAY).write_text(templates.render("replay.c"))


@pytest.mark.parametrize("precision", ["mixed", "double", "single"])
def test_code_compiles_without_a_warning(model, precision: str, warnings, tmp_path) -> None:
    write_sources(model, precision, tmp_path)
    assert warnings(tmp_path, "-std=c99", "hitch.c", REPLAY) == ""


@pytest.mark.parametrize("language", ["-std=c11", "-std=c++17 -x c++"])
def test_code_is_c11_and_cpp17_too(everything, language: str, warnings, tmp_path) -> None:
    write_sources(everything, "mixed", tmp_path)
    assert warnings(tmp_path, *language.split(), "hitch.c", REPLAY) == ""
