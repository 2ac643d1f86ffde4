"""FMI units: validity, parity, step sizes, saved states, refusals, reproducible bytes."""

import ctypes
import hashlib
import math
import os
import shutil
import struct
import sys
import threading
import zipfile
import zlib
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
    table = np.zeros(
        rows,
        dtype=[
            ("time", "f8"),
            ("lifting_command", "f8"),
            ("lowering_command", "f8"),
            ("displacement_measured", "f8"),
            ("measurement_valid", "?"),
        ],
    )
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


@pytest.mark.parametrize("kind", ["CoSimulation", "ModelExchange"])
@pytest.mark.parametrize("version", VERSIONS)
def test_a_simulation_is_the_model(units, commands, expected, version: str, kind: str) -> None:
    result = fmpy.simulate_fmu(
        str(units[version]),
        fmi_type=kind,
        start_values={"displacement_start": START},
        input=commands,
        output=OUTPUTS,
        stop_time=commands["time"][-1],
        step_size=STEP_S,
        output_interval=STEP_S,
    )
    # Of the two values at an event the one after it.
    result = result[np.append(np.diff(result["time"]) > 1e-9, True)]
    index = np.round(result["time"] / STEP_S).astype(int)
    np.testing.assert_array_equal(index, np.arange(len(commands)))
    np.testing.assert_allclose(result["displacement"], expected[index], atol=1e-6)
    assert (result["half_width"][:100] < 0).all()
    assert (result["half_width"][103:] > 0).all()


def slave(path, version: str, folder, name: str = "one"):
    """Return an instance of an FMU, and the references of its variables."""
    unzipped = fmpy.extract(str(path), str(folder / f"{name}"))
    description = fmpy.read_model_description(unzipped)
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    kind = FMU2Slave if version == "fmi2" else FMU3Slave
    instance = kind(
        guid=description.guid if version == "fmi2" else description.instantiationToken,
        unzipDirectory=unzipped,
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName=name,
    )
    instance.instantiate()
    return instance, references


def start(instance, version: str, references) -> None:
    """Initialise an instance at the start displacement."""
    if version == "fmi2":
        instance.setupExperiment(startTime=0.0)
        instance.setReal([references["displacement_start"]], [START])
        instance.enterInitializationMode()
    else:
        instance.setFloat64([references["displacement_start"]], [START])
        instance.enterInitializationMode(startTime=0.0)
    instance.exitInitializationMode()


def numbers(instance, version: str):
    """Return the functions that get and set real variables."""
    return (
        (instance.getReal, instance.setReal)
        if version == "fmi2"
        else (instance.getFloat64, instance.setFloat64)
    )


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("size_s", [STEP_S / 10, 0.7 * STEP_S, STEP_S, 3 * STEP_S, 1 / 60])
def test_any_step_size_takes_every_sample_once(
    units, everything, tmp_path, version: str, size_s: float
) -> None:
    instance, references = slave(units[version], version, tmp_path)
    start(instance, version, references)
    get, put = numbers(instance, version)
    put([references["lifting_command"]], [0.6])
    state, shown = everything.init_state(START), [START]
    for _ in range(220):
        state, displacement = everything.step(state, [0.6, 0.0])
        shown.append(float(displacement))
    time_s = 0.0
    while time_s < 2.0:
        instance.doStep(currentCommunicationPoint=time_s, communicationStepSize=size_s)
        time_s += size_s
        samples = int(np.floor(time_s / STEP_S + 1e-6))
        assert get([references["displacement"]])[0] == pytest.approx(shown[samples], abs=1e-5)
    instance.terminate()
    instance.freeInstance()


@pytest.mark.long
@pytest.mark.parametrize("version", VERSIONS)
def test_after_ten_hours_of_summed_steps_no_sample_is_lost(units, tmp_path, version: str) -> None:
    size_s, last_steps = 1 / 60, 300
    summed_s = np.cumsum(np.full(10 * 3600 * 60, size_s))  # as a host adds up its time
    begin_s = float(summed_s[-last_steps - 1])
    assert begin_s != round(begin_s * 60) / 60
    shown = {}
    for name, steps in (("sixtieths", [size_s] * last_steps), ("samples", [STEP_S] * (last_steps * 5 // 3))):
        instance, references = slave(units[version], version, tmp_path, name)
        start(instance, version, references)
        get, put = numbers(instance, version)
        instance.doStep(0.0, begin_s)
        put([references["lowering_command"]], [0.5])
        time_s, shown[name] = begin_s, []
        for step_s in steps:
            instance.doStep(time_s, step_s)
            time_s += step_s
            shown[name].append(get([references["displacement"]])[0])
        instance.freeInstance()
    # Every twentieth of a second both have taken the same samples.
    np.testing.assert_array_equal(shown["sixtieths"][2::3], shown["samples"][4::5])
    assert np.ptp(shown["samples"]) > 1.0


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_goes_back_and_into_bytes(units, tmp_path, version: str) -> None:
    instance, references = slave(units[version], version, tmp_path)
    start(instance, version, references)
    get, put = numbers(instance, version)

    def run(begin: int, instance=instance, get=get, put=put) -> list[float]:
        shown = []
        for number in range(begin, begin + 50):
            put([references["lifting_command"]], [0.7 if number % 30 < 20 else 0.0])
            instance.doStep(number * STEP_S, STEP_S)
            shown.append(get([references["displacement"]])[0])
        return shown

    run(0)
    is_2 = version == "fmi2"
    state = instance.getFMUstate() if is_2 else instance.getFMUState()
    saved = instance.serializeFMUstate(state) if is_2 else instance.serializeFMUState(state)
    expected = run(50)
    (instance.setFMUstate if is_2 else instance.setFMUState)(state)
    assert run(50) == expected
    other, _ = slave(units[version], version, tmp_path, "other")
    start(other, version, references)
    restored = other.deSerializeFMUstate(saved) if is_2 else other.deserializeFMUState(saved)
    (other.setFMUstate if is_2 else other.setFMUState)(restored)
    assert run(50, other, *numbers(other, version)) == expected
    for damaged in (saved[:-1], bytes(len(saved)), saved[:40] + bytes([saved[40] ^ 1]) + saved[41:]):
        with pytest.raises(Exception, match=r"eserialize|eSerialize"):
            (other.deSerializeFMUstate if is_2 else other.deserializeFMUState)(damaged)
    for _ in range(1000):
        again = other.deSerializeFMUstate(saved) if is_2 else other.deserializeFMUState(saved)
        (other.freeFMUstate if is_2 else other.freeFMUState)(again)
    instance.freeInstance()
    other.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_time_that_is_never_reached_is_refused(units, tmp_path, version: str) -> None:
    instance, references = slave(units[version], version, tmp_path)
    for time_s in (math.inf, -math.inf, math.nan, 1e300):
        begin = instance.setupExperiment if version == "fmi2" else instance.enterInitializationMode
        with pytest.raises(FMICallException):
            begin(startTime=time_s)
    start(instance, version, references)
    get, _ = numbers(instance, version)
    for size_s in (math.inf, -math.inf, math.nan, 1e300, -1.0, 2e7 * STEP_S):
        with pytest.raises(FMICallException):
            instance.doStep(0.0, size_s)
    instance.doStep(0.0, STEP_S)
    assert math.isfinite(get([references["displacement"]])[0])
    instance.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_that_was_never_saved_is_refused(units, tmp_path, version: str) -> None:
    instance, references = slave(units[version], version, tmp_path)
    start(instance, version, references)
    is_2 = version == "fmi2"
    state = instance.getFMUstate() if is_2 else instance.getFMUState()
    saved = bytes(instance.serializeFMUstate(state) if is_2 else instance.serializeFMUState(state))
    last = max(
        references.values()
    )  # after it: four of the next sample, samples, start time, last time, phase
    never = (math.nan, math.inf, -math.inf, 1e300, -1e300)
    for number, values in (
        *((references[name], never) for name in ("mode", "flags", "measurement_valid")),
        (last + 2, never),
        (last + 5, (math.nan, -1.0, -1e300)),
        (last + 6, never),
        (last + 7, never),
        (last + 8, (*never, 4.0)),
    ):
        for value in values:
            at = 16 + 8 * number
            changed = saved[:at] + struct.pack("<d", value) + saved[at + 8 : -4]
            changed += struct.pack("<I", zlib.adler32(changed))
            with pytest.raises(FMICallException):
                (instance.deSerializeFMUstate if is_2 else instance.deserializeFMUState)(changed)
    instance.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_two_instances_in_two_threads_are_two(units, tmp_path, version: str) -> None:
    def run(instance, references, into: list) -> None:
        get, put = numbers(instance, version)
        put([references["lifting_command"]], [0.7])
        for number in range(2000):
            instance.doStep(number * STEP_S, STEP_S)
            into.append(get([references["displacement"]])[0])

    results: list[list[float]] = [[], [], []]
    instances = [slave(units[version], version, tmp_path, str(number)) for number in range(3)]
    for instance, references in instances:
        start(instance, version, references)
    run(*instances[0], results[0])
    threads = [threading.Thread(target=run, args=(*instances[number], results[number])) for number in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("version", VERSIONS)
def test_what_may_not_be_set_is_refused(units, tmp_path, version: str) -> None:
    instance, references = slave(units[version], version, tmp_path)
    start(instance, version, references)
    get, put = numbers(instance, version)
    for name in ("displacement", "displacement_start"):
        with pytest.raises(Exception, match="Set"):
            put([references[name]], [1.0])
    with pytest.raises(Exception, match="Get"):
        get([999])
    put([references["lifting_dead_zone"]], [0.2])  # tunable
    assert get([references["lifting_dead_zone"]]) == [0.2]
    instance.freeInstance()


@pytest.mark.parametrize("version", VERSIONS)
def test_units_and_structure_are_told(units, version: str) -> None:
    root = ElementTree.fromstring(zipfile.ZipFile(units[version]).read("modelDescription.xml"))  # noqa: S314
    defined = {unit.get("name"): unit.find("BaseUnit") for unit in root.iter("Unit")}
    assert float(defined["mm"].get("factor")) == 1e-3
    assert defined["mm"].get("m") == "1"
    assert float(defined["bar"].get("factor")) == 1e5
    assert defined["A"].get("A") == "1"
    names = [each.get("name") for each in root.find("ModelVariables")]
    assert names[-4:] == OUTPUTS
    assert "load_pressure" in names
    unknowns = list(root.find("ModelStructure").iter("Unknown")) + list(
        root.find("ModelStructure").iter("Output")
    )
    assert [each.get("dependencies") for each in unknowns].count("") == len(unknowns) - (version == "fmi2")


@pytest.mark.long
def test_two_exports_are_the_same_bytes(everything, compiler, here, tmp_path) -> None:
    digests = set()
    for place in (tmp_path / "a.fmu", tmp_path / "b ü" / "b.fmu"):
        to_fmu(everything, place, version="fmi3", platforms=[here])
        digests.add(hashlib.sha256(place.read_bytes()).hexdigest())
    assert len(digests) == 1
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
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


def test_only_the_interface_is_visible(units, here, tmp_path) -> None:
    for version in VERSIONS:
        folder = tmp_path / version
        with zipfile.ZipFile(units[version]) as archive:
            (name,) = [each for each in archive.namelist() if each.startswith("binaries/")]
            archive.extract(name, folder)
        library = ctypes.CDLL(str(folder / name))
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
    result = fmpy.simulate_fmu(
        str(unzipped),
        start_values={"displacement_start": START},
        input=commands,
        output=OUTPUTS,
        stop_time=1.5,
        step_size=STEP_S,
        output_interval=STEP_S,
    )
    np.testing.assert_allclose(result["displacement"], expected[: len(result)], atol=1e-6)
