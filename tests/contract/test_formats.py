"""One protocol over every log format: what is written comes back, and nothing else ever does."""

import gzip
import struct
import sys

import numpy as np
import pytest

import hitchid
from hitchid.errors import InputError, LogError
from hitchid.logs import find_logs, format_of, write_table
from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats import BUILT_IN, record_name

SAMPLES = 60
RNG = np.random.default_rng(7)
TABLE = {
    "time_s": np.arange(SAMPLES) / 100,
    "current_up_A": RNG.choice([0.0, 0.5, 0.1], SAMPLES),
    "current_down_A": RNG.normal(size=SAMPLES) / 3,
    "displacement_mm": 1e3 * RNG.normal(size=SAMPLES),
}
TABLE["current_down_A"][:5] = -0.0, 5e-324, 1.7976931348623157e308, -1e-300, 0.1
NAMES = tuple(TABLE)
DOUBLES_ON_A_BUS = """VERSION ""

NS_ :

BS_:

BU_: ECU

BO_ 291 Bench: 24 ECU
 SG_ current_up_A : 0|64@1- (1,0) [0|0] "A" ECU
 SG_ current_down_A : 64|64@1- (1,0) [0|0] "A" ECU
 SG_ displacement_mm : 128|64@1- (1,0) [0|0] "mm" ECU

SIG_VALTYPE_ 291 current_up_A : 2;
SIG_VALTYPE_ 291 current_down_A : 2;
SIG_VALTYPE_ 291 displacement_mm : 2;
"""


def write_tabbed(path, columns):
    """Write text with tabs between columns and commas before decimals."""
    rows = zip(*(values.tolist() for values in columns.values()), strict=True)
    lines = ["\t".join(columns), *("\t".join(map(repr, row)).replace(".", ",") for row in rows), ""]
    data = "\n".join(lines).encode()
    path.write_bytes(gzip.compress(data) if path.name.lower().endswith(".gz") else data)


def write_mat5(path, columns):
    from scipy.io import savemat

    savemat(path, dict(columns))


def write_mat73(path, columns):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values[None]).attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124)
        stream.write(head + struct.pack("<H2s", 0x0200, b"IM"))


def write_hdf5(path, columns):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in columns.items():
            file.create_dataset(f"bench/{name}", data=values).attrs["unit"] = name.rpartition("_")[2]


def write_netcdf3(path, columns):
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        file.createDimension("time_s", columns["time_s"].size)
        for name, values in columns.items():
            variable = file.createVariable(name, "d", ("time_s",))
            variable[:], variable.units = values, name.rpartition("_")[2]


def write_bus(path, columns):
    """Write frames of three doubles each, and beside them the database that says so."""
    can = pytest.importorskip("can")
    path.with_name("bus.dbc").write_text(DOUBLES_ON_A_BUS)
    plain = path.with_name(path.name.lower().removesuffix(".gz"))
    kinds = {".blf": can.BLFWriter, ".trc": can.TRCWriter, ".log": can.CanutilsLogWriter}
    with kinds.get(plain.suffix, can.ASCWriter)(plain) as log:
        for stamp_s, *values in zip(*columns.values(), strict=True):
            log(
                can.Message(
                    timestamp=1.7e9 + stamp_s,
                    arbitration_id=291,
                    is_extended_id=False,
                    is_fd=plain.suffix != ".trc",
                    channel=0,
                    data=struct.pack("<3d", *values),
                )
            )
    if plain.suffix == ".trc":  # python-can writes no frame of CAN FD as one; its length code is 12
        plain.write_text(plain.read_text().replace(" DT ", " FD ").replace(" -  24 ", " -  12 "))
    if path.name.lower().endswith(".gz"):
        path.write_bytes(gzip.compress(plain.read_bytes()))
        plain.unlink()
    elif plain != path:
        plain.rename(path)


# How a log of each ending is made; a new format adds its line here.
WRITERS = {
    **dict.fromkeys((".csv", ".csv.gz", ".tdms", ".mf4", ".mdf", ".parquet"), write_table),
    **dict.fromkeys((".tsv", ".tsv.gz", ".lvm", ".txt", ".txt.gz", ".dat", ".dat.gz"), write_tabbed),
    **dict.fromkeys((".h5", ".hdf5"), write_hdf5),
    **dict.fromkeys((".asc", ".asc.gz", ".blf", ".trc", ".log"), write_bus),
    ".mat": write_mat5,
    ".nc": write_netcdf3,
}
ON_A_BUS = tuple(ending for ending, writer in WRITERS.items() if writer is write_bus)
PLAIN_TEXT = {".csv", ".tsv", ".lvm", ".txt", ".dat", ".asc", ".trc", ".log"}
ENDINGS = [suffix for log_format in BUILT_IN for suffix in log_format.suffixes]
every_ending = pytest.mark.parametrize("ending", ENDINGS)


@pytest.fixture
def log(tmp_path):
    """Return a function that writes a log with an ending and returns format, path and what to ask for."""

    def write(ending, columns=TABLE, name="log"):
        path = tmp_path / f"{name}{ending}"
        WRITERS[ending.lower()](path, columns)
        return format_of(path), path, ChannelSelection("time_s", NAMES[1:], tuple(tmp_path.glob("*.dbc")))

    return write


def assert_whole(content, path, samples=SAMPLES):
    """Check that channels are the first samples of the table, bit for bit, on its clock."""
    assert content.source == path
    assert set(NAMES[1:]) <= content.channels.keys() <= set(NAMES)
    for name in NAMES[1:]:
        channel, sent = content.channels[name], TABLE[name][:samples]
        assert channel.values.dtype == np.float64
        # A signal of a bus has an offset, and -0.0 + 0 is 0.0.
        sent = sent + 0.0 if path.name.lower().endswith(ON_A_BUS) else sent
        assert channel.values.tobytes() == sent.tobytes(), name
        if "time_s" in content.channels:
            assert content.channels["time_s"].values.tobytes() == TABLE["time_s"][:samples].tobytes()
        else:
            # A bus keeps the date, to a quarter of a microsecond in a double, the text whole microseconds.
            np.testing.assert_allclose(channel.clock_s, TABLE["time_s"][:samples], rtol=0, atol=1.5e-6)


def test_a_log_of_every_ending_is_made_here():
    assert sorted(WRITERS) == sorted(ENDINGS)
    assert len(set(ENDINGS)) == len(ENDINGS)


@every_ending
def test_what_was_written_comes_back_bit_for_bit(log, ending):
    log_format, path, wanted = log(ending)
    assert_whole(log_format.read(path, wanted), path)
    everything = log_format.read(path, wanted._replace(signals=None))
    assert {name.rpartition("/")[2] for name in everything.channels} >= set(NAMES[1:])


@every_ending
def test_a_format_that_is_written_is_written_bit_for_bit(tmp_path, ending):
    path = tmp_path / f"log{ending}"
    if format_of(path).write is None:
        with pytest.raises(InputError, match="cannot write this format"):
            write_table(path, TABLE)
        assert not path.exists()
        return
    write_table(path, TABLE)
    assert_whole(format_of(path).read(path, ChannelSelection("time_s", NAMES[1:])), path)


@every_ending
def test_channels_come_once_each_and_no_others(log, ending):
    log_format, path, wanted = log(ending)
    content = log_format.read(path, wanted._replace(signals=("displacement_mm", "displacement_mm")))
    assert content.channels.keys() - {"time_s"} == {"displacement_mm"}
    assert content.channels["displacement_mm"].unit in (None, "mm")


@every_ending
def test_a_missing_channel_is_named_beside_those_there_are(log, ending):
    log_format, path, wanted = log(ending)
    with pytest.raises(LogError) as caught:
        log_format.read(path, wanted._replace(signals=("current_up_A", "pressure_bar")))
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "'pressure_bar'" in message
    assert all(name in message for name in NAMES[1:])


@every_ending
def test_a_log_cut_short_is_refused_or_read_shorter(log, ending):
    log_format, path, wanted = log(ending)
    whole = path.read_bytes()
    refused = 0
    sizes = np.linspace(0, len(whole) - 1, 20).astype(int)
    for size in sizes.tolist():
        path.write_bytes(whole[:size])
        try:
            content = log_format.read(path, wanted)
        except LogError as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017
            refused += 1
            continue
        if ending not in PLAIN_TEXT:
            assert_whole(content, path)
            continue
        # Plain text cut short is a shorter log; only within its last number can a cut not be seen.
        rows = content.channels["displacement_mm"].values.size
        assert rows < SAMPLES or size > len(whole) - 30
        kept = {
            name: channel._replace(
                values=channel.values[: rows - 1],
                clock_s=None if channel.clock_s is None else channel.clock_s[: rows - 1],
            )
            for name, channel in content.channels.items()
        }
        assert_whole(type(content)(path, kept), path, rows - 1)
    assert refused >= (1 if ending in PLAIN_TEXT else 15)


NO_LOGS = {
    "nothing": b"",
    "a line end": b"\n",
    "every byte": bytes(range(256)),
    "random bytes": np.random.default_rng(11).bytes(3000),
}


@every_ending
@pytest.mark.parametrize("data", NO_LOGS.values(), ids=NO_LOGS)
def test_what_is_no_log_is_refused_by_name(log, ending, data):
    log_format, path, wanted = log(ending)
    path.write_bytes(data)
    with pytest.raises(LogError) as caught:
        log_format.read(path, wanted)
    assert str(caught.value).startswith(f"{path}: ")


@every_ending
def test_a_folder_or_a_missing_file_is_refused_by_name(log, tmp_path, ending):
    log_format, _, wanted = log(ending)
    (tmp_path / f"folder{ending}").mkdir()
    for name in ("folder", "missing"):
        path = tmp_path / f"{name}{ending}"
        with pytest.raises(LogError, match="cannot be read") as caught:
            log_format.read(path, wanted)
        assert str(caught.value).startswith(f"{path}: ")


@every_ending
@pytest.mark.parametrize("shouted", [False, True])
def test_every_ending_reaches_its_format_whatever_its_case(log, tmp_path, ending, shouted):
    written = ending.upper() if shouted else ending
    log_format, path, wanted = log(written, name="step 0.5 A [1]")
    assert ending in log_format.suffixes
    assert_whole(log_format.read(path, wanted), path)
    assert find_logs(tmp_path) == [path]
    assert record_name(path) == "step 0.5 A [1]"


@pytest.mark.parametrize(
    ("ending", "module", "package", "extra"),
    [
        (".tdms", "nptdms", "npTDMS", "tdms"),
        (".mf4", "asammdf", "asammdf", "mdf"),
        (".h5", "h5py", "h5py", "hdf5"),
        (".mat", "h5py", "h5py", "hdf5"),
        (".parquet", "pyarrow", "pyarrow", "parquet"),
        (".asc", "can", "python-can", "can"),
        (".blf", "can", "python-can", "can"),
        (".blf", "cantools", "cantools", "can"),
    ],
)
def test_a_missing_library_is_named_with_its_command(tmp_path, monkeypatch, ending, module, package, extra):
    writer = write_mat73 if ending == ".mat" else WRITERS[ending]
    path = tmp_path / f"log{ending}"
    writer(path, TABLE)
    for name in [name for name in sys.modules if name == module or name.startswith(f"{module}.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(LogError) as caught:
        format_of(path).read(path, ChannelSelection("time_s", NAMES[1:], tuple(tmp_path.glob("*.dbc"))))
    required = f"{package} is required to read it: pip install 'hitchid[{extra}]'"
    assert str(caught.value) == f"{path}: {required}"


def test_libraries_are_loaded_before_reading_time_counts():
    for log_format in BUILT_IN:
        if log_format.suffixes[0] == ".csv":
            assert log_format.libraries == ()
        for library in log_format.libraries:
            __import__(library)


# --- one campaign -------------------------------------------------------------------------------------------

WAYS = [
    *((ending, WRITERS[ending]) for ending in (".csv.gz", ".tsv", ".parquet", ".tdms", ".mf4", ".mat")),
    (".mat", write_mat73),
    *((ending, WRITERS[ending]) for ending in (".h5", ".nc", ".asc", ".blf", ".trc", ".log")),
]


def in_another_format(campaign, folder, ending, writer):
    """Write the logs of a campaign in another format and return what is read of them."""
    folder.mkdir()
    for record in campaign.records:
        columns = {
            "time_s": np.round(record.time_s, 4),
            "current_up_A": record.command("lifting"),
            "current_down_A": record.command("lowering"),
            "displacement_mm": record.displacement,
        }
        writer(folder / f"{record.name}{ending}", columns)
    return hitchid.read(folder)


@pytest.mark.parametrize(("ending", "writer"), WAYS)
def test_one_campaign_is_the_same_from_every_format(bench, tmp_path, ending, writer):
    campaign = hitchid.read(bench)
    again = in_another_format(campaign, tmp_path / "logs", ending, writer)
    assert [record.name for record in again.records] == [record.name for record in campaign.records]
    for one, other in zip(campaign.records, again.records, strict=True):
        assert other.fingerprint == one.fingerprint
        assert (other.step_s, other.kind, dict(other.units)) == (one.step_s, one.kind, dict(one.units))
        for role, samples in one.signals.items():
            assert other.signals[role].tobytes() == samples.tobytes()
