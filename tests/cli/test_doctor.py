"""`hitchid doctor`: what is missing for which command, without a path or a name of the user."""

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint, PackageNotFoundError
from pathlib import Path

import pytest
from commands import hitchid

from hitchid.cli import doctor

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]


def test_every_extra_is_said_to_be_for_something():
    state = doctor.examine()
    assert doctor.EXTRAS.keys() == PROJECT["optional-dependencies"].keys() == state["extras"].keys()
    assert {re.split(r"[>=<]", need)[0] for need in PROJECT["dependencies"]} == state["required"].keys()
    assert state["problems"] == []


@pytest.mark.parametrize("broken", ["missing", "too old"])
def test_a_missing_package_is_named_with_what_needs_it(monkeypatch, broken):
    def version(package, installed=doctor.version):
        if package not in ("nptdms", "equinox"):
            return installed(package)
        if broken == "missing":
            raise PackageNotFoundError(package)
        return "0.0.1"

    monkeypatch.setattr(doctor, "version", version)
    result = hitchid("doctor")
    assert result.code == 1
    assert re.search(r"hitchid\[tdms\] +logs \.tdms +missing: nptdms", result.out)
    installed = "none" if broken == "missing" else "0.0.1"
    assert f"fault: equinox: expected >=0.13, got {installed}\n" in result.out


def test_an_extra_of_a_package_counts(monkeypatch):
    needs = {"jax-cuda13-plugin": doctor.PackageNotFoundError}

    def version(package, installed=doctor.version):
        if package in needs:
            raise needs[package](package)
        return installed(package)

    monkeypatch.setattr(doctor, "version", version)
    assert not all(need["fits"] for need in doctor.examine()["extras"]["cuda"]["packages"].values())


def test_programs_that_are_missing_are_named(monkeypatch):
    monkeypatch.setattr(doctor, "_programs", lambda: ({"C compiler": None, "Octave": None}, []))
    result = hitchid("doctor")
    assert result.code == 0
    assert re.search(r"Octave +hitchid export: proof of MATLAB +missing\n", result.out)


def test_a_program_that_does_not_start_is_told(monkeypatch):
    monkeypatch.setenv("CC", "'never closed")
    result = hitchid("doctor")
    assert result.code == 0
    assert "notice: CC names a program that does not start; another one is used, if any\n" in result.out


@pytest.mark.parametrize("wrong", [{"XLA_FLAGS": "--bogus=/home/jane"}, {"JAX_ENABLE_X64": "jane"}])
def test_settings_that_end_jax_are_a_fault_without_their_text(wrong, monkeypatch):
    for name, value in wrong.items():
        monkeypatch.setenv(name, value)
    devices, problems = doctor._devices()
    assert devices == []
    assert re.fullmatch(r"JAX does not start: (its process ended with -?\d+|ValueError)", *problems)


BLOCKED = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name == "{package}":
            raise ModuleNotFoundError(name, name=name)
sys.meta_path.insert(0, Blocker())
sys.argv = ["hitchid", "doctor"]
from hitchid.__main__ import main
main()
"""


@pytest.mark.parametrize("package", ["equinox", "packaging", "typer"])
def test_without_a_package_there_is_a_report_or_a_message(package):
    program = [sys.executable, "-c", BLOCKED.format(package=package)]
    done = subprocess.run(program, capture_output=True, text=True, check=False)  # noqa: S603
    assert "Traceback" not in done.stdout + done.stderr
    if package == "typer":
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr == "hitchid: the package typer is missing; run: pip install --upgrade hitchid\n"
    elif package == "packaging":
        assert done.returncode == 1
        assert "fault: packaging: expected any version, got none\n" in done.stdout
    else:  # installed, but it cannot be imported: what needs it was left out
        assert "notice: programs were not looked for: ModuleNotFoundError\n" in done.stdout


def test_an_extension_that_cannot_be_imported_is_a_fault(monkeypatch):
    entry = EntryPoint("broken", "no.such.module:thing", "hitchid.structures")
    monkeypatch.setattr(doctor, "entry_points", lambda group: [entry] if group.endswith("structures") else [])
    name = "structures: broken of an installed package"
    assert doctor._extensions() == ([name], [f"{name}: cannot be imported: ModuleNotFoundError"])


def test_a_cache_that_cannot_be_read_costs_nothing(monkeypatch):
    def nowhere():
        raise RuntimeError("no home")

    monkeypatch.setattr(doctor, "cache_folder", nowhere)
    assert "cache: cannot be read, not writable\n" in hitchid("doctor").out


def test_nothing_of_the_user_is_shown(tmp_path):
    home = tmp_path / "jane-doe"
    home.mkdir()
    own = {"HOME": home, "USER": "jane-doe", "XDG_CACHE_HOME": home / "cache", "CC": home / "cc"}
    own |= {"XLA_FLAGS": f"--xla_dump_to={home}", "OCTAVE": home / "octave"}
    (home / "cc").write_text("#!/bin/sh\necho jane-doe cc built in /home/jane-doe 1.0\n")
    (home / "cc").chmod(0o755)
    for options in ([], ["--json"]):
        done = subprocess.run(  # noqa: S603
            [sys.executable, "-m", "hitchid", "doctor", *options],
            env=os.environ | {name: str(value) for name, value in own.items()},
            capture_output=True,
            text=True,
            check=True,
        )
        for secret in ("jane", str(tmp_path), sys.prefix, str(Path(doctor.__file__).parents[3])):
            assert secret not in done.stdout + done.stderr
    state = json.loads(done.stdout)
    assert {"CC", "OCTAVE", "XDG_CACHE_HOME", "XLA_FLAGS"} <= set(state["environment"])
    assert state["cache"]["writable"]
    assert state["processors"]["usable"] >= 1
    assert state["devices"]
