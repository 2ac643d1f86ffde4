"""`hitchid doctor`: what is missing for which command, without a path or a name of the user."""

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError
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
    found = "none" if broken == "missing" else "0.0.1"
    assert f"fault: equinox: expected >=0.13, found {found}\n" in result.out


def test_an_extra_of_a_package_counts(monkeypatch):
    needs = {"jax-cuda13-plugin": doctor.PackageNotFoundError}

    def version(package, installed=doctor.version):
        if package in needs:
            raise needs[package](package)
        return installed(package)

    monkeypatch.setattr(doctor, "version", version)
    assert not all(need["fits"] for need in doctor.examine()["extras"]["cuda"]["packages"].values())


def test_programs_that_are_missing_are_named(monkeypatch):
    monkeypatch.setattr(doctor, "_programs", lambda: {"C compiler": None, "Octave": None})
    result = hitchid("doctor")
    assert result.code == 0
    assert re.search(r"Octave +hitchid export: proof of MATLAB +missing\n", result.out)


def test_jax_that_does_not_start_is_a_fault_without_its_text(monkeypatch):
    def broken():
        raise RuntimeError("/home/jane/lib/libcuda.so")

    monkeypatch.setattr(doctor, "prepare_jax", broken)
    result = hitchid("doctor")
    assert (result.code, "jane" in result.out) == (1, False)
    assert "fault: JAX does not start: RuntimeError\n" in result.out


def test_nothing_of_the_user_is_shown(tmp_path):
    home = tmp_path / "jane-doe"
    home.mkdir()
    own = {"HOME": home, "USER": "jane-doe", "XDG_CACHE_HOME": home / "cache", "CC": home / "cc"}
    own |= {"XLA_FLAGS": f"--xla_dump_to={home}", "OCTAVE": home / "octave"}
    for options in ([], ["--json"]):
        done = subprocess.run(  # noqa: S603
            [sys.executable, "-m", "hitchid", "doctor", *options],
            env=os.environ | {name: str(value) for name, value in own.items()},
            capture_output=True,
            text=True,
            check=True,
        )
        for secret in (
            "jane",
            str(tmp_path),
            sys.prefix,
            str(Path(doctor.__file__).parents[3]),
            os.uname().nodename,
        ):
            assert secret not in done.stdout + done.stderr
    state = json.loads(done.stdout)
    assert {"CC", "OCTAVE", "XDG_CACHE_HOME", "XLA_FLAGS"} <= set(state["environment"])
    assert state["cache"]["writable"]
    assert state["processors"]["usable"] >= 1
    assert state["devices"]
