"""Models that the tests of the export share."""

import subprocess

import pytest
from export_models import MODELS

from hitchid.export import to_c
from hitchid.export.verification import find_compiler
from hitchid.model import Hitch


@pytest.fixture(scope="session")
def compiler():
    """Return the C compiler of this machine."""
    own = find_compiler()
    if own is None:
        pytest.skip("no C compiler is installed")
    return own


WARNINGS = "-Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Werror -fsyntax-only"
# Between them they have every part; the others have one each.
TOGETHER = ("everything", "covariates along the stroke", "first order, fractional dead time")


@pytest.fixture(
    params=[name if name in TOGETHER else pytest.param(name, marks=pytest.mark.long) for name in MODELS],
    scope="session",
)
def model(request) -> Hitch:
    """Return each hand-made model."""
    return MODELS[request.param]


@pytest.fixture(scope="session")
def everything() -> Hitch:
    """Return the model with all parts."""
    return MODELS["everything"]


@pytest.fixture(scope="session")
def exported(everything, compiler, tmp_path_factory):
    """Return the folder of the model with all parts as C."""
    folder = tmp_path_factory.mktemp("export") / "with ü and spaces"
    to_c(everything, folder)
    return folder


@pytest.fixture(scope="session")
def warnings(compiler):
    """Return a function that gives what a strict compiler has to say about sources in a folder."""

    def of(folder, *arguments) -> str:
        command = [*compiler.command, *WARNINGS.split(), *arguments]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False).stderr  # noqa: S603

    return of
