"""A stranger's model in generated code: its texts stay comments and names, its proof stays in a folder."""

import ast
import ctypes
import re
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from export_models import MODELS

from hitchid._support.files import write_files
from hitchid._support.inert import comment, printable
from hitchid.export.c_templates import c_templates
from hitchid.export.constants import constants_of
from hitchid.export.model_description import fmu_variables, model_description
from hitchid.export.verification import run_replay
from hostile import STRINGS

PLAIN = constants_of(MODELS["everything"])
WORST = '*\\\n/ __attribute__((constructor)) void f(void) { abort(); } /* """'
# What a compiler does before it sees comments, in its order: trigraphs of a backslash, then continued lines.
CONTINUED = re.compile(r"(?:\\|\?\?/)\r?\n")
COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)


def code(header: str) -> str:
    """Return what a compiler sees of a header."""
    return " ".join(COMMENT.sub(" ", CONTINUED.sub("", header)).split())


def instructions(source: str) -> str:
    """Return the instructions of a Python module, without its docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
            and ast.get_docstring(node) is not None
        ):
            node.body = node.body[1:]
    return ast.dump(tree)


def test_comments_of_all_strings_in_one_program_are_comments(compiler, tmp_path) -> None:
    lines = "\n".join(f"    /* {comment(text)} */ n++; /* {comment(text)}, */" for text in STRINGS)
    source = tmp_path / "all.c"
    source.write_text(f"int main(void)\n{{\n    int n = 0;\n{lines}\n    return n != {len(STRINGS)};\n}}\n")
    compiler.compile([source], tmp_path / "all", "-trigraphs", "-Wall", "-Werror")
    assert subprocess.run([tmp_path / "all"], check=False).returncode == 0  # noqa: S603


def test_strings_leave_the_code_of_a_model_as_it_is() -> None:
    def templates(texts: tuple[str, ...]):
        units = dict.fromkeys(PLAIN.units, WORST) | dict(zip(texts, texts, strict=True))
        model = replace(PLAIN, units=units, covariates=texts, mean_load=(1.0,) * len(texts))
        return c_templates(model, "hitch", "mixed")

    hostile, plain = templates(STRINGS), templates(tuple(f"name {number}" for number in range(len(STRINGS))))
    assert code(hostile.render("model.h")) == code(plain.render("model.h"))
    assert instructions(hostile.render("library.py")) == instructions(plain.render("library.py"))
    for template in ("model.c", "replay.c"):  # which name none of them
        assert hostile.render(template) == plain.render(template)


@pytest.mark.parametrize("version", ["fmi2", "fmi3"])
def test_units_and_names_in_a_description_stay_text(version: str) -> None:
    model = replace(PLAIN, covariates=STRINGS, mean_load=(1.0,) * len(STRINGS))
    model = replace(model, units={**model.units, **dict(zip(STRINGS, STRINGS, strict=True))})
    parameters = c_templates(PLAIN, "m", "mixed").context["parameters"]
    variables = list(fmu_variables(model, parameters, 0.0, with_time=True))
    symbols = [variable.symbol for variable in variables]
    assert len(set(symbols)) == len(symbols)
    assert all(re.fullmatch("[A-Z][A-Z0-9_]*", symbol) for symbol in symbols)
    root = ElementTree.fromstring(model_description(version, "m", "{1}", variables, 0.01, ["m.c"], "x"))  # noqa: S314
    tags = {element.tag for element in root.iter()}
    plain = list(fmu_variables(PLAIN, [], 0.0, with_time=True))
    described = model_description(version, "m", "{1}", plain, 0.01, ["m.c"], "x")
    assert tags == {element.tag for element in ElementTree.fromstring(described).iter()}  # noqa: S314
    listed = [element.get("name") for element in root.find("UnitDefinitions")]
    assert {printable(text) for text in STRINGS if text} <= set(listed)


def test_a_model_of_hostile_texts_is_compiled_and_imported(compiler, tmp_path) -> None:
    templates = c_templates(replace(PLAIN, units=dict.fromkeys(PLAIN.units, WORST)), "hitch", "mixed")
    sources = {"hitch.h": "model.h", "hitch.c": "model.c", "hitch.py": "library.py"}
    write_files(tmp_path, {file: templates.render(template).encode() for file, template in sources.items()})
    compiler.compile([tmp_path / "hitch.c"], tmp_path / "libhitch.so", "-O0", "-fPIC", "-shared")
    program = "import hitch; print(hitch.Model(100.0).step(0.0, 0.0), hitch.Model.__doc__)"
    arguments = [sys.executable, "-S", "-c", program]
    done = subprocess.run(arguments, cwd=tmp_path, capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout.startswith("1")
    assert comment(WORST) in done.stdout


PROBE = r"""
#include <stdio.h>
#include <stdlib.h>
int main(int count, char **arguments)
{
    const double row[4] = { 0, 0, 0, 0 };
    FILE *file = fopen(arguments[2], "wb");
    fwrite(row, sizeof row, 1, file);
    fclose(file);
    if (getenv("HOME") != NULL || getenv("PATH") != NULL) return 10;
    if (fopen("%OUTSIDE%/read", "rb") != NULL) return 11;
    if (fopen("%OUTSIDE%/written", "wb") != NULL) return 12;
    return count == 3 ? 0 : 13;
}
"""


def test_a_proof_sees_its_folder_alone(compiler, tmp_path) -> None:
    landlock = ctypes.CDLL(None).syscall(444, None, ctypes.c_size_t(0), ctypes.c_uint32(1))
    if sys.platform != "linux" or landlock < 1:
        pytest.skip("this kernel has no Landlock")
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    (outside / "read").write_text("secret")
    (inside / "probe.c").write_text(PROBE.replace("%OUTSIDE%", str(outside)))
    compiler.compile([inside / "probe.c"], inside / "probe")
    rows = run_replay([str(inside / "probe")], np.zeros(2), np.zeros((1, 2)), inside)
    np.testing.assert_array_equal(rows, np.zeros((1, 4)))
    assert not (outside / "written").exists()
