"""`hitchid doctor`: what is installed, what is missing for which command, and where computing happens."""

import json
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, distribution, entry_points, version
from typing import TYPE_CHECKING, Any

import typer

from hitchid._support.jax_setup import cache_folder
from hitchid.cli import options

if TYPE_CHECKING:
    from packaging.requirements import Requirement

# What each extra, and each program beside Python, is for.
EXTRAS = {
    "can": "logs .asc, .blf, .trc, .log; CAN in .mf4",
    "control": "in Python: models for python-control",
    "cuda": "computing on a GPU of NVIDIA",
    "fleet": "hitchid fleet",
    "fmu": "hitchid export: FMUs for other systems",
    "hdf5": "logs .h5, .nc, .mat of version 7.3",
    "hmi": "hitchid hmi",
    "mdf": "logs .mf4, .mdf",
    "onnx": "hitchid export --to onnx",
    "pandas": "in Python: DataFrames",
    "parquet": "logs .parquet",
    "pdf": "--pdf",
    "tdms": "logs .tdms",
    "xlsx": "--xlsx",
}
PROGRAMS = {
    "C compiler": "hitchid export: FMUs, proof of C",
    "Octave": "hitchid export: proof of MATLAB",
}
GROUPS = ("structures", "baselines", "formats", "renderers")  # entry points of other packages
# Variables that change what a run does. Values may hold names and places of the user, and are not shown.
VARIABLES = re.compile(
    "(JAX|XLA|CUDA|HITCHID)_.*|CC|LD_LIBRARY_PATH|OCTAVE|OMP_NUM_THREADS|PYTHONPATH|XDG_CACHE_HOME"
)
# Of what a program says of itself only its kind and number are shown: the rest may be anything.
KINDS = ("clang", "zig", "gcc", "Octave", "Debian", "cc")
# A process of its own: wrong flags end it at once, and a driver may hang. Time limit in s; JAX starts in two.
DEVICES = """
from hitchid._support.jax_setup import prepare_jax
prepare_jax()
import jax, json
print(json.dumps([[device.platform, device.device_kind] for device in jax.devices()]))
"""
LONGEST_START_S = 120.0


def doctor(as_json: options.AsJson = False) -> None:
    """Show what is installed, which extras and programs are missing for what, and where computing happens.

    Holds what a report of a fault needs, without a path or a name of the user. Exit code 1 if a package
    that every command needs is missing or too old, or JAX does not start.
    """
    state = examine()
    typer.echo(json.dumps(state, indent=2) if as_json else text_of(state))
    if state["problems"]:
        raise typer.Exit(1)


def examine() -> dict[str, Any]:
    """Return the state of this installation, as data for JSON."""
    devices, problems = _devices()
    try:
        required, extras = _requirements()
    except ModuleNotFoundError as error:  # of packaging, which compares versions
        required, extras, problems = {}, {}, [*problems, f"{error.name}: expected any version, got none"]
    programs, notes = _programs()
    extensions, broken = _extensions()
    problems += [
        f"{name}: expected {need['expected'] or 'any version'}, got {need['installed'] or 'none'}"
        for name, need in required.items()
        if not need["fits"]
    ]
    return {
        "hitchid": version("hitchid"),
        "installed_for_development": _is_editable(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": platform.platform(),
        "processors": _processors(),
        "devices": devices,
        "required": required,
        "extras": {
            name: {"for": EXTRAS.get(name, ""), "packages": packages} for name, packages in extras.items()
        },
        "programs": {name: {"for": PROGRAMS[name], "version": number} for name, number in programs.items()},
        "extensions": extensions,
        "cache": _cache(),
        "environment": sorted(filter(VARIABLES.fullmatch, os.environ)),
        "notes": notes,
        "problems": problems + broken,
    }


def _requirements() -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return the packages that are always needed, and those of each extra, with the versions installed."""
    from packaging.requirements import Requirement

    distributed = distribution("hitchid")
    required: dict[str, Any] = {}
    extras: dict[str, dict[str, Any]] = {
        name: {} for name in sorted(distributed.metadata.get_all("Provides-Extra") or [])
    }
    for requirement in map(Requirement, distributed.requires or []):
        marker, state = requirement.marker, _state(requirement)
        if marker is None or marker.evaluate({"extra": ""}):
            required[requirement.name] = state
        for name, packages in extras.items():
            if marker is not None and marker.evaluate({"extra": name}):
                packages[str(requirement).partition(";")[0].strip()] = state
    return required, extras


def _state(requirement: "Requirement") -> dict[str, Any]:
    """Return the version of a required package, and whether it fits; packages of its own extras count."""
    from packaging.requirements import Requirement

    try:
        installed = version(requirement.name)
    except PackageNotFoundError:
        installed = None
    fits = installed is not None and requirement.specifier.contains(installed, prereleases=True)
    further = map(Requirement, distribution(requirement.name).requires or []) if fits else ()
    for inner in further:
        if inner.marker and any(inner.marker.evaluate({"extra": name}) for name in requirement.extras):
            fits = fits and _state(inner)["fits"]
    return {"expected": str(requirement.specifier), "installed": installed, "fits": fits}


def _is_editable() -> bool:
    """Return whether the package is used from a folder of sources."""
    stated = json.loads(distribution("hitchid").read_text("direct_url.json") or "{}")
    return bool(stated.get("dir_info", {}).get("editable"))


def _processors() -> dict[str, Any]:
    """Return how many processors there are and may be used, and the memory, GiB."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    memory = None
    if hasattr(os, "sysconf") and {"SC_PAGE_SIZE", "SC_PHYS_PAGES"} <= os.sysconf_names.keys():
        memory = round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    return {"installed": os.cpu_count(), "usable": usable, "memory_GiB": memory}


def _devices() -> tuple[list[str], list[str]]:
    """Return the devices on which JAX computes, and why it does not start, if so."""
    command = [sys.executable, "-c", DEVICES]
    try:
        done = subprocess.run(  # noqa: S603
            command, capture_output=True, text=True, errors="replace", timeout=LONGEST_START_S, check=False
        )
        if done.returncode == 0:
            # Of a processor kind and platform are the same.
            return [" ".join(dict.fromkeys(device)) for device in json.loads(done.stdout)], []
        reason = next(reversed(done.stderr.splitlines()), "").partition(":")[0]
        if not re.fullmatch(r"\w+(\.\w+)*Error", reason):  # anything else may hold a path
            reason = f"its process ended with {done.returncode}"
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        reason = type(error).__name__
    return [], [f"JAX does not start: {reason}"]


def _programs() -> tuple[dict[str, str | None], list[str]]:
    """Return kind and version of each program, and notes on those that are named and do not start."""
    notes: list[str] = []
    try:
        from hitchid.export.matlab import find_octave
        from hitchid.export.verification import find_compiler
    except Exception as error:  # what is missing is among the problems
        return dict.fromkeys(PROGRAMS), [f"programs were not looked for: {type(error).__name__}"]
    compiler, octave = find_compiler(), find_octave()
    named = {"CC": compiler and compiler.command[0], "OCTAVE": octave and octave.program}
    for variable, program in named.items():
        if variable in os.environ and _first_word(os.environ[variable]) != program:
            notes.append(f"{variable} names a program that does not start; another one is used, if any")
    versions = {"C compiler": compiler and compiler.version, "Octave": octave and octave.version}
    return {name: said and _kind_and_number(said) for name, said in versions.items()}, notes


def _first_word(command: str) -> str | None:
    """Return the program of a command line, where it is found."""
    try:
        words = shlex.split(command)
    except ValueError:
        return None
    return shutil.which(words[0]) if words else None


def _kind_and_number(said: str) -> str:
    kind = next((kind for kind in KINDS if re.search(rf"\b{kind}\b", said)), "unknown")
    number = re.search(r"\d+(\.\d+)+", said)
    return f"{'gcc' if kind in ('Debian', 'cc') else kind} {number[0] if number else ''}".strip()


def _extensions() -> tuple[list[str], list[str]]:
    """Return what other packages register, and which of it cannot be imported."""
    registered, broken = [], []
    for group in GROUPS:
        for entry in entry_points(group=f"hitchid.{group}"):
            package = f"{entry.dist.name} {entry.dist.version}" if entry.dist else "an installed package"
            name = f"{group}: {entry.name} of {package}"
            registered.append(name)
            try:
                entry.load()
            except Exception as error:  # the code of another package may raise anything
                broken.append(f"{name}: cannot be imported: {type(error).__name__}")
    return sorted(registered), sorted(broken)


def _cache() -> dict[str, Any]:
    """Return how much is kept of earlier runs, and whether more can be; nothing where it cannot be read."""
    try:
        folder = cache_folder()
        sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
        existing = next(place for place in (folder, *folder.parents) if place.exists())
        is_writable = existing.is_dir() and os.access(existing, os.W_OK)
    except (OSError, RuntimeError):  # no home, no permission, another run that cleans up
        return {"files": None, "MB": None, "writable": False}
    return {"files": len(sizes), "MB": round(sum(sizes) / 1e6, 1), "writable": is_writable}


def text_of(state: dict[str, Any]) -> str:
    """Return the state as lines and tables, what is missing at the end."""
    from hitchid._support.tables import Table

    processors, cache = state["processors"], state["cache"]
    memory = f", {processors['memory_GiB']} GiB memory" if processors["memory_GiB"] else ""
    copy = " (development copy)" if state["installed_for_development"] else ""
    size = "cannot be read" if cache["files"] is None else f"{cache['files']} files, {cache['MB']} MB"
    lines = [
        f"hitchid {state['hitchid']}{copy}, {state['python']}, {state['system']}",
        f"computes on: {', '.join(state['devices']) or 'nothing'}; "
        f"{processors['usable']} of {processors['installed']} processors{memory}",
        f"cache: {size}, {'' if cache['writable'] else 'not '}writable",
        f"set in the environment: {', '.join(state['environment']) or 'nothing that matters'}",
        f"extensions: {'; '.join(state['extensions']) or 'none'}",
        "required: " + ", ".join(f"{name} {need['installed']}" for name, need in state["required"].items()),
    ]
    rows = []
    for name, extra in state["extras"].items():
        missing = [package for package, need in extra["packages"].items() if not need["fits"]]
        state_text = f"missing: {', '.join(missing)}" if missing else "installed"
        rows.append((f"hitchid[{name}]", extra["for"], state_text))
    for name, program in state["programs"].items():
        rows.append((name, program["for"], program["version"] or "missing"))
    table = Table("", ("part", "for", "state"), tuple(rows))
    notes = [f"notice: {note}" for note in state["notes"]]
    problems = [f"fault: {problem}" for problem in state["problems"]]
    verdict = [] if problems else ["Nothing that every command needs is missing."]
    return "\n".join([*lines, table.text(), *notes, *problems, *verdict])
