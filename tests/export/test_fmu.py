"""FMI units: validity, parity, step sizes, saved states, refusals, reproducible bytes."""

import ctypes
import math
import os
import shutil
import struct
import sys
import zipfile
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from hitchid.errors import InputError, OutputError
from hitchid.export import fmu, to_fmu

fmpy = pytest.importorskip("fmpy")
from fmpy.build import build_platform_binary  # noqa: E402
from fmpy.fmi1 import FMICallException  # noqa: E402
from fmpy.fmi2 import FMU2Slave  # noqa: E402
from fmpy.fmi3 import FMU3Slave  # noqa: E402
from fmpy.validation import validate_fmu  # noqa: E402

VERSIONS = ("fmi2", "fmi3")
STEP_S, START = 0.01, 100.0
OUTPUTS = ["displacement", "mode", "flags", "half_width"]


@pytest.fixture(scope="session")
def here():
    """Return the platform of this machine."""
    name = fmu._this_platform()
    if name is None:
        pytest.skip("no FMU platform")
    return name


@pytest.fixture(scope="session")
def units(everything, compiler, here, tmp_path_factory):
    """Return version to FMU of the model with all parts."""
    folder = tmp_path_factory.mktemp("fmus with ü")
    for version in VERSIONS:
        to_fmu(everything, folder / f"{version}.fmu", version=version, platforms=[here])
    return {version: folder / f"{version}.fmu" for version in VERSIONS}


@pytest.fixture(scope="session")
def commands():
    """Return commands and measured displacement over four seconds."""
    rng = np.random.default_rng(0)
    rows = 400
    levels = np.repeat(rng.uniform(0, 0.8, (rows // 20, 2)), 20, axis=0)
    levels[:, 1] *= rng.random(rows) > 0.5
    names = ("time", "lifting_command", "lowering_command", "displacement_measured")
    table = np.zeros(rows, dtype=[*((name, "f8") for name in names), ("measurement_valid", "?")])
    table["time"] = STEP_S * np.arange(rows)
    table["lifting_command"], table["lowering_command"] = levels.T
    table["displacement_measured"] = START + np.cumsum(rng.normal(0, 0.05, rows))
    table["measurement_valid"] = np.arange(rows) > 100
    return table


@pytest.fixture(scope="session")
def expected(everything, commands):
    """Return the model's displacement at every time."""
    state, displacements = everything.init_state(START), [START]
    for row in commands:
        measured = row["displacement_measured"] if row["measurement_valid"] else np.nan
        state, displacement = everything.step(
            state, [row["lifting_command"], row["lowering_command"]], measured
        )
        displacements.append(float(displacement))
    return np.array(displacements)


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_a_validator_finds_no_problem(units, version: str) -> None:
    assert validate_fmu(str(units[version])) == []


def simulated(path, commands, stop_s: float, kind: str = "CoSimulation") -> np.ndarray:
    """Return what a unit computes for commands at every sample, its outputs by name."""
    return fmpy.simulate_fmu(
        str(path),
        fmi_type=kind,
        start_values={"displacement_start": START},
        input=commands,
        output=OUTPUTS,
        stop_time=stop_s,
        step_size=STEP_S,
        output_interval=STEP_S,
    )


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("version", VERSIONS)
def test_a_simulation_is_the_model(units, commands, expected, version: str, kind: str) -> None:
    result = simulated(units[version], commands, commands["time"][-1], kind)
    # Of the two values at an event the one after it.
    result = result[np.append(np.diff(result["time"]) > 1e-9, True)]
    index = np.round(result["time"] / STEP_S).astype(int)
    np.testing.assert_array_equal(index, np.arange(len(commands)))
    np.testing.assert_allclose(result["displacement"], expected[index], atol=1e-6)
    assert (result["half_width"][:100] < 0).all()
    assert (result["half_width"][103:] > 0).all()


class Unit:
    """An instance of an FMU of either version, by the same names."""

    def __init__(self, path, version: str, folder, name: str = "one"):
        unzipped = fmpy.extract(str(path), str(folder / name))
        description = fmpy.read_model_description(unzipped)
        self.references = {variable.name: variable.valueReference for variable in description.modelVariables}
        kind, self.is_2 = (FMU2Slave, True) if version == "fmi2" else (FMU3Slave, False)
        self.own = kind(
            guid=description.guid if self.is_2 else description.instantiationToken,
            unzipDirectory=unzipped,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=name,
        )
        self.own.instantiate()
        own, state = self.own, "state" if self.is_2 else "State"
        self.get_number, self.put_number = (
            (own.getReal, own.setReal) if self.is_2 else (own.getFloat64, own.setFloat64)
        )
        self.state, self.set_state, self.free_state, self.serialize = (
            getattr(own, f"{verb}FMU{state}") for verb in ("get", "set", "free", "serialize")
        )
        self.deserialize = own.deSerializeFMUstate if self.is_2 else own.deserializeFMUState
        self.step = own.doStep

    def begin(self, time_s: float) -> None:
        (self.own.setupExperiment if self.is_2 else self.own.enterInitializationMode)(startTime=time_s)

    def start(self) -> "Unit":
        """Initialise it at the start displacement."""
        self.put("displacement_start", START)
        self.begin(0.0)
        if self.is_2:
            self.own.enterInitializationMode()
        self.own.exitInitializationMode()
        return self

    def get(self, name: str) -> float:
        return self.get_number([self.references[name]])[0]

    def put(self, name: str, value: float) -> None:
        self.put_number([self.references[name]], [value])

    def shown(self, command: str, size: float, begin: int, count: int) -> list[float]:
        """Take samples under a command that is given up every third of a second; return displacements."""
        rows = []
        for number in range(begin, begin + count):
            self.put(command, size if number % 30 < 20 else 0.0)
            self.step(number * STEP_S, STEP_S)
            rows.append(self.get("displacement"))
        return rows


@pytest.fixture
def unit(units, tmp_path):
    """Return a function that gives a new instance of a version, started."""
    made = []

    def make(version: str) -> Unit:
        made.append(Unit(units[version], version, tmp_path, f"number {len(made)}"))
        return made[-1].start()

    yield make
    for instance in made:
        instance.own.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("size_s", [STEP_S / 10, 0.7 * STEP_S, STEP_S, 3 * STEP_S, 1 / 60])
def test_any_step_size_takes_every_sample_once(unit, everything, version: str, size_s: float) -> None:
    own = unit(version)
    own.put("lifting_command", 0.6)
    state, expected = everything.init_state(START), [START]
    for _ in range(220):
        state, displacement = everything.step(state, [0.6, 0.0])
        expected.append(float(displacement))
    time_s = 0.0
    while time_s < 2.0:
        own.step(time_s, size_s)
        time_s += size_s
        samples = int(np.floor(time_s / STEP_S + 1e-6))
        assert own.get("displacement") == pytest.approx(expected[samples], abs=1e-5)


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_after_ten_hours_of_summed_steps_no_sample_is_lost(unit, version: str) -> None:
    size_s, last_steps = 1 / 60, 300
    summed_s = np.cumsum(np.full(10 * 3600 * 60, size_s))  # as a host adds up its time
    begin_s = float(summed_s[-last_steps - 1])
    assert begin_s != round(begin_s * 60) / 60
    shown = {}
    for name, steps in (("sixtieths", [size_s] * last_steps), ("samples", [STEP_S] * (last_steps * 5 // 3))):
        own = unit(version)
        own.step(0.0, begin_s)
        own.put("lowering_command", 0.5)
        time_s, shown[name] = begin_s, []
        for step_s in steps:
            own.step(time_s, step_s)
            time_s += step_s
            shown[name].append(own.get("displacement"))
    # Every twentieth of a second both have taken the same samples.
    np.testing.assert_array_equal(shown["sixtieths"][2::3], shown["samples"][4::5])
    assert np.ptp(shown["samples"]) > 1.0


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_goes_back_and_into_bytes(unit, version: str) -> None:
    own, other = unit(version), unit(version)
    own.shown("lifting_command", 0.7, 0, 50)
    state = own.state()
    saved = own.serialize(state)
    expected = own.shown("lifting_command", 0.7, 50, 50)
    own.set_state(state)
    assert own.shown("lifting_command", 0.7, 50, 50) == expected
    other.set_state(other.deserialize(saved))
    assert other.shown("lifting_command", 0.7, 50, 50) == expected
    for damaged in (saved[:-1], bytes(len(saved)), saved[:40] + bytes([saved[40] ^ 1]) + saved[41:]):
        with pytest.raises(Exception, match=r"eserialize|eSerialize"):
            other.deserialize(damaged)
    for _ in range(1000):
        other.free_state(other.deserialize(saved))


@pytest.mark.parametrize("version", VERSIONS)
def test_a_time_that_is_never_reached_is_refused(units, tmp_path, version: str) -> None:
    own = Unit(units[version], version, tmp_path)
    for time_s in (math.inf, -math.inf, math.nan, 1e300):
        with pytest.raises(FMICallException):
            own.begin(time_s)
    own.start()
    for size_s in (math.inf, -math.inf, math.nan, 1e300, -1.0, 2e7 * STEP_S):
        with pytest.raises(FMICallException):
            own.step(0.0, size_s)
    own.step(0.0, STEP_S)
    assert math.isfinite(own.get("displacement"))
    own.own.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_that_was_never_saved_is_refused(unit, version: str) -> None:
    own = unit(version)
    saved = bytes(own.serialize(own.state()))
    # After the last variable: four of the next sample, samples, start time, last time, phase.
    last = max(own.references.values())
    never = (math.nan, math.inf, -math.inf, 1e300, -1e300)
    for number, values in (
        *((own.references[name], never) for name in ("mode", "flags", "measurement_valid")),
        *((last + offset, never) for offset in (2, 6, 7)),
        (last + 5, (math.nan, -1.0, -1e300)),
        (last + 8, (*never, 4.0)),
    ):
        for value in values:
            at = 16 + 8 * number
            changed = saved[:at] + struct.pack("<d", value) + saved[at + 8 : -4]
            changed += struct.pack("<I", zlib.adler32(changed))
            with pytest.raises(FMICallException):
                own.deserialize(changed)


@pytest.mark.parametrize("version", VERSIONS)
def test_two_instances_in_two_threads_are_two(unit, version: str) -> None:
    instances = [unit(version) for _ in range(3)]
    alone = instances[0].shown("lifting_command", 0.7, 0, 2000)
    with ThreadPoolExecutor(2) as pool:
        runs = pool.map(lambda own: own.shown("lifting_command", 0.7, 0, 2000), instances[1:])
    assert list(runs) == [alone, alone]


@pytest.mark.parametrize("version", VERSIONS)
def test_what_may_not_be_set_is_refused(unit, version: str) -> None:
    own = unit(version)
    for name in ("displacement", "displacement_start"):
        with pytest.raises(Exception, match="Set"):
            own.put(name, 1.0)
    with pytest.raises(Exception, match="Get"):
        own.get_number([999])
    own.put("lifting_dead_zone", 0.2)  # tunable
    assert own.get("lifting_dead_zone") == 0.2


@pytest.mark.parametrize("version", VERSIONS)
def test_units_and_structure_are_told(units, version: str) -> None:
    root = ElementTree.fromstring(zipfile.ZipFile(units[version]).read("modelDescription.xml"))  # noqa: S314
    defined = {unit.get("name"): unit.find("BaseUnit") for unit in root.iter("Unit")}
    assert float(defined["mm"].get("factor")) == 1e-3
    assert defined["mm"].get("m") == "1"
    assert float(defined["bar"].get("factor")) == 1e5
    assert defined["A"].get("A") == "1"
    names = [element.get("name") for element in root.find("ModelVariables")]
    assert names[-4:] == OUTPUTS
    assert "load_pressure" in names
    unknowns = list(root.find("ModelStructure").iter("Unknown")) + list(
        root.find("ModelStructure").iter("Output")
    )
    independent = sum(element.get("dependencies") == "" for element in unknowns)
    assert independent == len(unknowns) - (version == "fmi2")


@pytest.mark.long
def test_a_unit_is_an_archive_of_compressed_files(units) -> None:
    with zipfile.ZipFile(units["fmi3"]) as archive:
        assert archive.testzip() is None
        assert all(entry.compress_type == zipfile.ZIP_DEFLATED for entry in archive.infolist())
        assert not any("\\" in name or ".." in name for name in archive.namelist())


@pytest.mark.long
def test_without_ziglang_another_platform_is_refused(
    everything, compiler, here, tmp_path, monkeypatch
) -> None:
    monkeypatch.setattr(fmu, "zig_compiler", lambda: None)
    other = next(name for name in fmu.PLATFORMS if name != here)
    with pytest.raises(InputError, match=f"platform {other}: this machine compiles for {here} only"):
        to_fmu(everything, tmp_path / "a.fmu", platforms=[other])
    to_fmu(everything, tmp_path / "a.fmu", compensators=False)
    assert validate_fmu(str(tmp_path / "a.fmu")) == []
    with pytest.raises(OutputError, match="exists already"):
        to_fmu(everything, tmp_path / "a.fmu")
    with pytest.raises(InputError, match="platform"):
        to_fmu(everything, tmp_path / "b.fmu", platforms=["atari"])
    assert not (tmp_path / "b.fmu").exists()


def test_only_the_interface_is_visible(units, tmp_path) -> None:
    for version in VERSIONS:
        with zipfile.ZipFile(units[version]) as archive:
            (name,) = (name for name in archive.namelist() if name.startswith("binaries/"))
            library = ctypes.CDLL(archive.extract(name, tmp_path / version))
        assert hasattr(library, f"{version}GetVersion")
        assert not hasattr(library, "hitch_step")


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_the_sources_inside_compile(units, compiler, version: str, tmp_path) -> None:
    with zipfile.ZipFile(units[version]) as archive:
        archive.extractall(tmp_path)
    sources = tmp_path / "sources"
    warnings = ("-Wall", "-Wextra", "-Wpedantic", "-Werror", "-shared", "-fPIC")
    compiler.compile([sources / "hitch.c", sources / f"hitch_{version}.c"], sources / "built.so", *warnings)
    for name in ("hitch.c", "hitch.h", f"hitch_{version}.c"):
        assert (sources / name).read_bytes().isascii()


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_a_tool_builds_a_unit_that_holds_sources_only(
    units, commands, expected, version: str, tmp_path, monkeypatch
) -> None:
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)  # cmake, of fmpy
    unzipped = Path(fmpy.extract(str(units[version]), str(tmp_path / "unit")))
    shutil.rmtree(unzipped / "binaries")
    build_platform_binary(unzipped)
    assert list((unzipped / "binaries").rglob("hitch.*"))
    result = simulated(unzipped, commands, 1.5)
    np.testing.assert_allclose(result["displacement"], expected[: len(result)], atol=1e-6)
