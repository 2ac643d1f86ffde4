"""Build a release: sdist and wheel, checked and tried in fresh environments; hashes, bill of materials.

    python -m tools.release [--pinned]

Into dist/; it publishes nothing. Each step ends with a line of what was shown. Fresh environments take their
packages from the index that pip is set up with: the newest that the metadata allows, or those of pins.txt.
"""

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from datetime import UTC, datetime
from email import message_from_string
from pathlib import Path
from zipfile import ZipFile

from packaging.metadata import Metadata

ROOT = Path(__file__).parents[1]
VERSIONS = ("3.11", "3.12", "3.13", "3.14")
MAX_BYTES = 2_000_000  # of each file
TESTS = 4  # a direction, of the virtual bench: the fewest from which a model and a verdict come in a minute
SBOM_TOOL = "cyclonedx-bom==7.5.0"
OF_OURS = ("PYTHON", "JAX_", "XLA_", "HITCHID_")  # variables that change what a run does
ENVIRONMENT = {name: value for name, value in os.environ.items() if not name.startswith(OF_OURS)}


class ReleaseError(Exception):
    """A release is not as it has to be."""


def main() -> int:
    """Build the release, or say what is wrong with it."""
    parser = argparse.ArgumentParser(prog="python -m tools.release")
    parser.add_argument("--pinned", action="store_true", help="install the versions of pins.txt")
    pinned, out = parser.parse_args().pinned, ROOT / "dist"
    try:
        if changed := run(["git", "status", "--porcelain"], ROOT):
            raise ReleaseError(f"expected a tree without changes, got {changed.splitlines()[0].strip()}")
        version, date = stated_version(ROOT)
        found = pythons()
        if VERSIONS[0] not in found:
            raise ReleaseError(
                f"expected Python {VERSIONS[0]} to try it on, got {', '.join(found) or 'none'}"
            )
        say(f"version {version} of {date:%Y-%m-%d}, {tag_of(version)}")
        with tempfile.TemporaryDirectory() as place:
            first, second = (build(ROOT, Path(place) / name, date) for name in ("a", "b"))
            check_same(first, second)
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir()
            built = [Path(shutil.copy2(path, out)) for path in first]
            say(f"two builds in two folders are equal: {', '.join(path.name for path in built)}")
            wheel = built[-1]
            check_metadata(wheel, version)
            say(f"metadata are valid; {', '.join(f'{path.stat().st_size / 1e6:.2f} MB' for path in built)}")
            for name, python in found.items():
                program = try_out(wheel, python, Path(place) / f"python{name}", pinned=pinned)
                say(f"Python {name}: installed, and README's example ran")
            write_sbom(program, out / f"hitchid-{version}.cdx.json", Path(place) / "sbom")
        say(f"hashes: {write_hashes(out).name}; bill of materials of Python {name}")
        if missing := [name for name in VERSIONS if name not in found]:
            say(f"not tried, for it is not installed here: Python {', '.join(missing)}")
    except ReleaseError as error:
        say(f"no release: {error}")
        return 1
    return 0


def say(line: str) -> None:
    """Print a line at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def run(command: Sequence[object], folder: Path, environment: dict[str, str] | None = None) -> str:
    """Return the output of a command.

    Raises:
        ReleaseError: it fails.
    """
    done = subprocess.run(  # noqa: S603
        list(map(str, command)),
        cwd=folder,
        env=environment or ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise ReleaseError(f"{' '.join(map(str, command))}: {done.stderr or done.stdout}")
    return done.stdout


def stated_version(root: Path) -> tuple[str, datetime]:
    """Return the version of pyproject.toml and the day that the changelog gives for it.

    Raises:
        ReleaseError: the changelog's newest version is another one, or it holds unreleased changes.
    """
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    text = (root / "CHANGELOG.md").read_text()
    newest = re.search(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d{2}-\d{2})$", text, re.MULTILINE)
    if newest is None or newest[1] != version:
        raise ReleaseError(f"CHANGELOG.md: expected '## [{version}] - YYYY-MM-DD' as the newest version")
    unreleased = re.findall(r"^ *[-*] .*$", text[: newest.start()], re.MULTILINE)
    if unreleased:
        raise ReleaseError(f"CHANGELOG.md: expected nothing unreleased, got '{unreleased[0]}'")
    try:
        return version, datetime.fromisoformat(newest[2]).replace(tzinfo=UTC)
    except ValueError as error:
        raise ReleaseError(f"CHANGELOG.md: expected a day for {version}, got '{newest[2]}'") from error


def tag_of(version: str) -> str:
    """Return whether the commit has the tag of a version."""
    tags = run(["git", "tag", "--points-at", "HEAD"], ROOT).split()
    return f"tag v{version}" if f"v{version}" in tags else f"without its tag: git tag v{version}"


def build(root: Path, place: Path, date: datetime) -> tuple[Path, Path]:
    """Return sdist and wheel, built from a copy of the sources in a folder, without the network.

    The wheel is built from the unpacked sdist, as an installation from it would.
    """
    tree, out = place / "tree", place / "out"
    tree.mkdir(parents=True)
    for name in ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "SECURITY.md"):
        shutil.copy(root / name, tree)
    for name in run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "src"], root
    ).splitlines():
        if (root / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(root / name, tree / name)
    stamped = ENVIRONMENT | {"SOURCE_DATE_EPOCH": str(int(date.timestamp()))}
    hatch = [sys.executable, "-m", "hatchling", "build", "-d", out, "-t"]
    run([*hatch, "sdist"], tree, stamped)
    (sdist,) = out.glob("*.tar.gz")
    shutil.unpack_archive(sdist, place / "unpacked", filter="data")
    run([*hatch, "wheel"], place / "unpacked" / sdist.name.removesuffix(".tar.gz"), stamped)
    (wheel,) = out.glob("*.whl")
    return sdist, wheel


def check_same(first: Sequence[Path], second: Sequence[Path]) -> None:
    """Check that two builds are equal, byte by byte.

    Raises:
        ReleaseError: they are not.
    """
    for one, other in zip(first, second, strict=True):
        if one.name != other.name or one.read_bytes() != other.read_bytes():
            raise ReleaseError(f"{one.name} and {other.name} of two builds differ")


def check_metadata(wheel: Path, version: str) -> None:
    """Check a wheel's metadata, and the size of all that was built.

    Raises:
        ReleaseError: metadata are not valid or another version's, or a file is too large.
    """
    with ZipFile(wheel) as archive:
        text = archive.read(f"hitchid-{version}.dist-info/METADATA").decode()
    try:
        metadata = Metadata.from_email(text, validate=True)
    except Exception as error:  # a group of them, one for each field
        raise ReleaseError(f"{wheel.name}: {error!r}") from error
    stated = metadata.name, str(metadata.version), metadata.license_expression, str(metadata.requires_python)
    if stated != ("hitchid", version, "Apache-2.0", f">={VERSIONS[0]}"):
        raise ReleaseError(f"{wheel.name}: {stated}")
    if not message_from_string(text).get_payload():
        raise ReleaseError(f"{wheel.name}: without the description of README.md")
    for path in wheel.parent.iterdir():
        if path.stat().st_size > MAX_BYTES:
            raise ReleaseError(f"{path.name}: {path.stat().st_size} bytes, expected at most {MAX_BYTES}")


def pythons() -> dict[str, Path]:
    """Return each version of Python found here: that of pyenv, or the first in PATH."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    programs = {}
    for version in VERSIONS:
        in_path = shutil.which(f"python{version}")
        candidates = [*sorted(pyenv.glob(f"{version}.*/bin/python")), *([Path(in_path)] if in_path else [])]
        candidates.append(Path(sys.base_prefix) / "bin" / f"python{version}")  # of this environment
        program = next((python for python in candidates if _is_version(python, version)), None)
        if program is not None:
            programs[version] = program
    return programs


def _is_version(python: Path, version: str) -> bool:
    """Return whether a file is a Python of a version that starts; a shim may lead to none."""
    if not python.is_file():
        return False
    program = "import sys; print('%d.%d' % sys.version_info[:2])"
    done = subprocess.run([python, "-c", program], capture_output=True, text=True, check=False)  # noqa: S603
    return done.returncode == 0 and done.stdout.strip() == version


def try_out(wheel: Path, python: Path, place: Path, *, pinned: bool) -> Path:
    """Install a wheel into a fresh environment, run README's example there; return its Python.

    Raises:
        ReleaseError: a step fails, or the program is another one than the wheel's.
    """
    run([python, "-m", "venv", place / "venv"], Path.home())
    program, home = place / "venv" / "bin" / "python", place / "home"
    home.mkdir()
    install = [program, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", wheel]
    if pinned:
        # Versions alone: with hashes pip would ask for one of the wheel, too.
        pins = re.sub(r" \\$|^ +--hash=.*\n", "", (ROOT / "pins.txt").read_text(), flags=re.MULTILINE)
        (place / "constraints.txt").write_text(pins)
        install += ["--constraint", place / "constraints.txt"]
    run(install, home)
    # Without the repository and the caches of this machine.
    own = ENVIRONMENT | {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    run([program, "-m", "pip", "check"], home, own)
    run([program.with_name("hitchid"), "doctor"], home, own)
    run([program.with_name("hitchid"), "bench", "logs", "--tests", TESTS], home, own)
    (example,) = re.findall(
        r"The same from Python:\n\n```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL
    )
    shown = run([program, "-W", "error::DeprecationWarning:hitchid", "-c", example], home, own)
    if "free run" not in shown or not (home / "model" / "model.json").is_file():
        raise ReleaseError(f"README's example: no model, or no verdict in '{shown[:200]}'")
    return program


def write_sbom(python: Path, out: Path, place: Path) -> None:
    """Write the bill of materials (CycloneDX) of an environment, made by a tool in one of its own."""
    run([sys.executable, "-m", "venv", place], Path.home())
    run([place / "bin" / "python", "-m", "pip", "install", "--quiet", SBOM_TOOL], Path.home())
    command = [place / "bin" / "cyclonedx-py", "environment", python, "--pyproject", ROOT / "pyproject.toml"]
    run([*command, "--output-reproducible", "--of", "JSON", "-o", out], Path.home())


def write_hashes(folder: Path) -> Path:
    """Write the SHA-256 of all files of a folder, as `sha256sum -c` reads them."""
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(folder.iterdir())
    ]
    out = folder / "SHA256SUMS"
    out.write_text("".join(lines))
    return out


if __name__ == "__main__":
    sys.exit(main())
