"""The built wheel: what is in it, and that the program starts from it on the oldest and newest Python."""

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from zipfile import ZipFile

import pytest

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[1]
VERSIONS = ("3.11", "3.12", "3.13", "3.14")
DATA = {
    "hitchid/py.typed",
    "hitchid/report/templates/page.html",
    "hitchid/report/templates/page.css",
    "hitchid/report/templates/report.typ",
    "hitchid/bench/parameters/nominal.toml",
}
ENVIRONMENT = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def run(*command: object) -> str:
    """Return the output of a command that must succeed without a warning on stderr."""
    done = subprocess.run(  # noqa: S603
        list(map(str, command)), capture_output=True, text=True, env=ENVIRONMENT, cwd=Path.home()
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return done.stdout


def is_version(python: str | Path, version: str) -> bool:
    """Return whether a file is a Python of a version that starts; a shim may lead to none."""
    program = "import sys; print('%d.%d' % sys.version_info[:2])"
    done = subprocess.run([python, "-c", program], capture_output=True, text=True)  # noqa: S603
    return done.returncode == 0 and done.stdout.strip() == version


def find_python(version: str) -> Path | None:
    """Return a Python of a version: that of pyenv, or the first in PATH."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    in_path = shutil.which(f"python{version}")
    candidates = [*sorted(pyenv.glob(f"{version}.*/bin/python")), *([Path(in_path)] if in_path else [])]
    return next((python for python in candidates if is_version(python, version)), None)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel from a copy of the sources, without the network."""
    place = tmp_path_factory.mktemp("wheel")
    tree = place / "tree"
    tree.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    shutil.copytree(ROOT / "src", tree / "src", ignore=shutil.ignore_patterns("__pycache__"))
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(place)]
    done = subprocess.run(build, cwd=tree, capture_output=True, text=True)  # noqa: S603
    assert done.returncode == 0, done.stderr
    (built,) = place.glob("*.whl")
    return built


def test_the_wheel_holds_the_package_and_nothing_else(wheel):
    names = set(ZipFile(wheel).namelist())
    packaged = {name for name in names if ".dist-info/" not in name}
    sources = {
        path.relative_to(ROOT / "src").as_posix()
        for path in (ROOT / "src").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert packaged == sources
    assert packaged >= DATA
    metadata = {name.partition(".dist-info/")[2] for name in names - packaged}
    assert metadata == {"METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"}


@pytest.fixture(scope="module")
def pythons():
    """Return the oldest and the newest Python found here."""
    pythons = [python for version in VERSIONS if (python := find_python(version)) is not None]
    if len(pythons) < 2:
        pytest.skip(f"needs two of Python {', '.join(VERSIONS)}; found {len(pythons)}")
    return {"oldest": pythons[0], "newest": pythons[-1]}


@pytest.mark.parametrize("age", ["oldest", "newest"])
def test_the_program_starts_from_the_wheel(wheel, pythons, age, tmp_path):
    """Pure Python packages come from the environment of the tests; compiled ones would not load."""
    run(pythons[age], "-m", "venv", "--without-pip", tmp_path / "venv")
    python = tmp_path / "venv" / "bin" / "python"
    install = ["install", "--quiet", "--no-deps", "--no-index", "--no-compile", "--disable-pip-version-check"]
    run(sys.executable, "-m", "pip", "--python", python, *install, wheel)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))").strip())
    (site / "dependencies.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    package = site / "hitchid"

    home, version = run(
        python, "-W", "error", "-c", "import hitchid; print(hitchid.__file__); print(hitchid.__version__)"
    ).splitlines()
    assert Path(home).parent.samefile(package)
    assert wheel.name.startswith(f"hitchid-{version}-")
    assert run(tmp_path / "venv" / "bin" / "hitchid", "--version") == f"hitchid {version}\n"
    assert "Commands:" in run(tmp_path / "venv" / "bin" / "hitchid", "--help")
    run(python, "-W", "error", "-m", "compileall", "-q", "-f", package)
