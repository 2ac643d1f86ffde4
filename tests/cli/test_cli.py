"""The command line as a user meets it: exit codes, what goes where, and that bad input leaves no trace."""

import csv
import json
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from importlib.metadata import version
from xml.etree import ElementTree

import numpy as np
import pytest
from commands import hitchid

import benches
import handmade
from hitchid import cli
from hitchid._support.files import MANIFEST_FILE
from hitchid.errors import FitError
from hitchid.logs import read
from hitchid.model import save

COMMANDS = [command.callback.__name__ for command in cli.app.registered_commands]
QUICK = """
[search]
method = "multi-start"
evaluations = 60
compare = false
[training]
hidden = 6
window = 20
epochs = 8
baselines = false
"""
FIGURES = {"rmse", "mae", "r2", "fit", "max_abs", "within_1", "rmse_error"}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Return the folder of a model with every part, put together by hand."""
    folder = tmp_path_factory.mktemp("model") / "model"
    save(handmade.hitch("integrator", compensated=True, baselines=True), folder)
    return folder


@pytest.fixture
def logs(bench_folder, tmp_path):
    """Return a folder of logs of this test's own."""
    return shutil.copytree(bench_folder, tmp_path / "logs")


@pytest.fixture
def refused(tmp_path):
    """Return a function that runs the program and checks that it refuses in one line, without a trace."""

    def written() -> dict:
        return {path: path.lstat().st_mtime_ns for path in tmp_path.rglob("*")}

    def run(*arguments, said) -> None:
        before = written()
        result = hitchid(*arguments)
        assert (result.code, len(result.err.splitlines())) == (2, 1)
        assert result.err.startswith("hitchid: ")
        assert [word for word in said if word not in result.err] == [], result.err
        assert written() == before

    return run


# --- help ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_has_an_example_of_it(command):
    result = hitchid(command, "--help")
    assert (result.code, result.err) == (0, "")
    example = result.out[result.out.index("Example: ") :]
    assert f" hitchid {command} " in example


def test_the_help_names_every_command_and_has_a_short_option():
    result = hitchid("--help")
    assert result.code == 0
    assert all(f"  {command}" in result.out for command in COMMANDS)
    assert {"inspect", "identify", "validate", "simulate"} <= set(COMMANDS)
    for command in ([], ["identify"]):
        assert hitchid(*command, "-h") == hitchid(*command, "--help")


def test_the_version_is_that_of_the_package():
    assert hitchid("--version") == (0, f"hitchid {version('hitchid')}\n", "")


@pytest.mark.parametrize("arguments", [["--help"], ["identify", "--help"]])
def test_help_imports_neither_jax_nor_numpy(arguments):
    program = (
        f"import sys; sys.argv[1:] = {arguments!r}\n"
        "from hitchid.cli import main\n"
        "try: main()\n"
        "except SystemExit as done: print('imported:', {'jax', 'numpy'} & set(sys.modules), done.code)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)  # noqa: S603
    assert "Usage: " in done.stdout
    assert done.stdout.endswith("imported: set() 0\n")


@pytest.mark.parametrize(
    "arguments",
    [[], ["nonsense"], ["inspect"], ["identify", "logs"], ["simulate", "--foo"], ["inspect", "--json"]],
)
def test_wrong_use_is_answered_with_the_usage(arguments):
    result = hitchid(*arguments)
    assert result.code == 2
    assert "Usage: hitchid" in result.err
    assert "Traceback" not in result.err


# --- logs that cannot be used -------------------------------------------------------------------------------


def cell(row, column, text):
    """Return an edit that changes one cell; row 0 is the header."""

    def edit(lines):
        cells = lines[row].split(",")
        cells[column] = text
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return edit


def every_cell(column, text, rows=slice(1, None)):
    """Return an edit that changes the cells of some rows."""

    def edit(lines):
        for row in range(*rows.indices(len(lines))):
            lines = cell(row, column, text)(lines)
        return lines

    return edit


# What readers say of broken logs is proved in tests/logs; here, that every command says it in one line.
BAD_LOGS = {
    "a missing column": (cell(0, 3, "height_mm"), ["line 1", "'displacement_mm'", "height_mm"]),
    "text in many numbers": (
        every_cell(3, "4x2", slice(5, 9)),
        ["line 6", "'displacement_mm'", "number", "'4x2'"],
    ),
    "a constant displacement": (every_cell(3, "5.0"), ["constant", "5 mm", "check"]),
    "time that runs back": (cell(9, 0, "0.01"), ["line 10", "'time_s'", "must not decrease", "0.01 s"]),
    "time that stands still": (every_cell(0, "0.07"), ["line 3", "'time_s'", "time stamps are 0.07 s"]),
    "an empty file": (lambda lines: [], ["empty", "expected"]),
    "five samples": (lambda lines: lines[:6], ["5 samples", "at least 20"]),
    "binary garbage": (lambda lines: ["\udcff\udc80" * 99], ["UTF-8"]),
}


@pytest.mark.parametrize(("edit", "said"), BAD_LOGS.values(), ids=BAD_LOGS)
def test_a_bad_log_is_refused_by_every_command(refused, logs, model, tmp_path, edit, said):
    log = logs / "lifting-02.csv"
    text = "\n".join([*edit(log.read_text().splitlines()), ""])
    log.write_bytes(text.encode("utf-8", errors="surrogateescape"))
    said = [log.name, *said]
    refused("identify", logs, "--out", tmp_path / "out", "--strict", said=said)
    refused("simulate", model, log, "--out", tmp_path / "out.csv", said=said)
    shown = hitchid("inspect", logs, "--strict")
    assert (shown.code, len(shown.err.splitlines())) == (2, 1)
    assert shown.err.startswith("fault: ")
    assert all(word in shown.err for word in said)
    assert "lowering-03" in shown.out  # the other logs


def test_samples_without_a_number_are_named_and_alone_lost(logs, model, tmp_path):
    path, out = logs / "lifting-02.csv", tmp_path / "out.csv"

    def predicted():
        result = hitchid("simulate", model, path, "--out", out, "--force")
        assert result.code == 0
        with out.open() as file:
            cells = [row["displacement_predicted_mm"] for row in csv.DictReader(file)]
        return np.array([float(cell or "nan") for cell in cells]), result.err

    whole, messages = predicted()
    assert "left out" not in messages
    path.write_text("\n".join([*cell(5, 1, "")(path.read_text().splitlines()), ""]))
    content = json.loads(hitchid("inspect", logs, "--strict", "--json").out)
    (finding,) = (reported for reported in content["findings"] if reported["check"] == "not measured")
    assert (finding["level"], finding["records"]) == ("warning", ["lifting-02"])
    assert finding["signal"] == "lifting_command"
    left_out = "1 of 250 samples are left out, the first in line 6"
    assert f"{left_out}: they hold no number" in finding["what"]
    cells, messages = predicted()
    assert f"notice: lifting_command: {left_out}" in messages
    np.testing.assert_array_equal(cells, whole)  # at rest the command before it is the one that is missing


def test_inspect_leaves_a_bad_log_out_and_counts(logs):
    (logs / "lifting-02.csv").write_text("")
    result = hitchid("inspect", logs)
    assert result.code == 0
    assert result.err.startswith("warning: lifting-02: left out: ")
    assert "warning: 1 of 6 logs left out\n" in result.err


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("missing", ["missing", "no such file or folder"]),
        ("notes.md", ["notes.md", "format is not known", ".csv"]),
        ("empty", ["empty", "no log", ".csv"]),
        ("loop.csv", ["loop.csv", "is a broken link to"]),
        ("a" * 300 + ".csv", ["aaa"]),
    ],
    ids=["missing", "unknown ending", "empty folder", "symlink loop", "endless name"],
)
def test_a_path_that_is_no_log_is_refused(refused, tmp_path, model, name, said):
    (tmp_path / "notes.md").write_text("no log")
    (tmp_path / "empty").mkdir()
    (tmp_path / "loop.csv").symlink_to("loop.csv")
    log, out = tmp_path / name, ("--out", tmp_path / "out")
    for arguments in (("inspect", log), ("identify", log, *out), ("validate", model, log, *out)):
        refused(*arguments, said=said)


# --- settings that cannot be used ---------------------------------------------------------------------------

BAD_CAMPAIGNS = {
    "a misspelt key": ('[signals]\ndisplacment = "x_mm"', ["'signals.displacment'", "not known"]),
    "no TOML": ("[signals\n", ["not valid TOML", "line 1"]),
    "a kind of test nobody knows": ('[tests]\n"lifting-*" = "up"', ["'tests.lifting-*'", "'ramp'", "'up'"]),
}


@pytest.mark.parametrize(("text", "said"), BAD_CAMPAIGNS.values(), ids=BAD_CAMPAIGNS)
def test_a_campaign_file_that_is_not_understood_is_refused(refused, logs, tmp_path, text, said):
    (logs / "campaign.toml").write_text(text)
    for arguments in (("inspect", logs), ("identify", logs, "--out", tmp_path / "out")):
        refused(*arguments, said=["campaign.toml", *said])


def test_a_split_that_matches_nothing_is_refused(refused, logs, tmp_path):
    (logs / "campaign.toml").write_text('[split]\ntest = ["lifting-9*"]')
    arguments = ("identify", logs, "--quiet", "--out", tmp_path / "out")
    refused(*arguments, said=["split.test", "'lifting-9*'", "6 tests"])


BAD_CONFIGS = {
    "a misspelt section": ("[serch]\n", ["'serch'", "not known"]),
    "a misspelt key": ("[training]\nhiden = 3", ["'training.hiden'", "not known"]),
    "a structure nobody knows": ('[lifting]\nstructure = "triple"', ["'triple'", "integrator-first-order"]),
    "bounds reversed": (
        '[lifting]\nstructure = "integrator"\nbounds = { gain = [100, 5] }',
        ["gain", "100", "5", "expected"],
    ),
    "bounds of no parameter": (
        '[lifting]\nstructure = "integrator"\nbounds = { gian = [5, 100] }',
        ["gian", "gain"],
    ),
    "bounds without end": (
        '[lowering]\nstructure = "integrator"\nbounds = { gain = [5, inf] }',
        ["gain", "inf"],
    ),
    "a negative dead zone": ("[lifting]\ndead_zone = -1", ["'lifting.dead_zone'", "got -1"]),
    "a search nobody knows": ('[search]\nmethod = "fish"', ["'search.method'", "'whale'", "'fish'"]),
    "a window of one": ("[training]\nwindow = 1", ["'training.window'", "got 1"]),
    "no TOML": ("seed = \n", ["not valid TOML", "line 1"]),
    "a seed too large": (f"seed = {10**20}\n{QUICK}", ["seed", str(10**20)]),
    "a rate without end": (QUICK + "learning_rate = inf", ["'training.learning_rate'", "inf"]),
}


@pytest.mark.parametrize(("text", "said"), BAD_CONFIGS.values(), ids=BAD_CONFIGS)
def test_settings_that_are_not_understood_are_refused(refused, bench_folder, tmp_path, text, said):
    file = tmp_path / "settings.toml"
    file.write_text(text)
    arguments = ("identify", bench_folder, "--out", tmp_path / "out", "--config", file)
    refused(*arguments, said=["settings.toml", *said])


@pytest.mark.parametrize("option", ["--config", "--signals"])
def test_a_settings_file_that_is_not_there_is_refused(refused, bench_folder, tmp_path, option):
    arguments = ("identify", bench_folder, "--out", tmp_path / "out", option, tmp_path / "no.toml")
    refused(*arguments, said=["no.toml"])


@pytest.mark.parametrize("seed", ["-1", "x", str(10**20)])
def test_a_seed_that_is_none_is_refused(bench_folder, tmp_path, seed):
    result = hitchid("identify", bench_folder, "--out", tmp_path / "out", f"--seed={seed}")
    assert result.code == 2
    assert "seed" in result.err
    assert not (tmp_path / "out").exists()


# --- models that cannot be used -----------------------------------------------------------------------------


def edited(file, old, new):
    """Return an edit that replaces text in a file of a model folder."""

    def edit(folder):
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))

    return edit


def cut(file, keep):
    """Return an edit that cuts a file of a model folder short."""
    return lambda folder: (folder / file).write_bytes((folder / file).read_bytes()[:keep])


# Every other damage is refused where models are read: tests/model/test_artifact.py.
BAD_MODELS = {
    "no folder": (shutil.rmtree, ["model.json", "expected a model folder"]),
    "weights cut short": (cut("weights.safetensors", -10), ["weights.safetensors", "truncated", "expected"]),
    "description edited": (
        edited("model.json", '"step_s": 0.01', '"step_s": 0.02'),
        ["model.json", "edited"],
    ),
    "description cut short": (cut("model.json", 200), ["model.json", "truncated"]),
    "description too deep": (lambda f: (f / "model.json").write_text("[" * 100_000), ["model.json"]),
    "trace edited": (edited("trace.json", "{", "{ "), ["trace.json", "edited"]),
    "a newer schema": (
        edited("model.json", '"schema": 14', '"schema": 15'),
        ["model.json", "schema 15", "expected 14"],
    ),
}


@pytest.mark.parametrize(("edit", "said"), BAD_MODELS.values(), ids=BAD_MODELS)
def test_a_model_that_is_not_whole_is_refused(refused, bench_folder, model, tmp_path, edit, said):
    folder = shutil.copytree(model, tmp_path / "model")
    edit(folder)
    log = bench_folder / "lifting-01.csv"
    refused("simulate", folder, log, "--out", tmp_path / "out.csv", said=said)
    refused("validate", folder, log.parent, "--out", tmp_path / "out", said=said)


def test_a_model_that_only_lifts_refuses_lowering(refused, bench_folder, tmp_path):
    save(handmade.hitch("integrator", modes=("lifting",)), tmp_path / "model")
    log = bench_folder / "lowering-01.csv"
    refused("simulate", tmp_path / "model", log, "--out", tmp_path / "out.csv", said=["lowering"])


@pytest.mark.parametrize("horizon", ["0", "-1", "1.5", "far", "", "inf", "1e3", "\u00b2"])
def test_a_horizon_that_is_none_is_refused(refused, bench_folder, model, tmp_path, horizon):
    log = bench_folder / "lifting-01.csv"
    said = ["--horizon", "'free'", f"'{horizon}'"]
    refused("simulate", model, log, "--out", tmp_path / "out.csv", f"--horizon={horizon}", said=said)


# --- places that are taken ----------------------------------------------------------------------------------


def test_a_place_that_is_taken_is_left_alone(refused, bench_folder, model, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "precious").write_text("mine")
    for arguments in (("identify", bench_folder), ("validate", model, bench_folder)):
        refused(*arguments, "--out", out, said=["out", "exists already", "--force"])
        refused(*arguments, "--out", out, "--force", said=["out", "--force does not replace it"])
        file = out / "precious"
        refused(*arguments, "--out", file, "--force", said=["precious", "--force does not replace it"])


def test_a_file_that_is_there_is_left_alone(refused, bench_folder, model, tmp_path):
    log, out = bench_folder / "lifting-01.csv", tmp_path / "out.csv"
    out.write_text("mine")
    refused("simulate", model, log, "--out", out, said=["out.csv", "exists already", "--force"])
    refused("simulate", model, log, "--out", tmp_path, "--force", said=[tmp_path.name, "exists already"])
    refused("simulate", model, log, "--out", out / "deeper.csv", said=["out.csv"])
    refused("simulate", model, log, "--out", tmp_path / ("a" * 300), said=["aaa"])


# --- good runs ----------------------------------------------------------------------------------------------


def test_inspect_lists_every_log_and_prints_json_of_the_same(bench_folder):
    table, described = (hitchid("inspect", bench_folder, *options) for options in ((), ("--json",)))
    assert (table.code, table.err) == (described.code, described.err) == (0, "")
    content = json.loads(described.out)
    assert set(content) == {"records", "notices", "faults", "left_out", "findings"}
    names = [f"{mode}-{number:02d}" for mode in ("lifting", "lowering") for number in (1, 2, 3)]
    assert [record["name"] for record in content["records"]] == names
    assert [record["held_out"] for record in content["records"]] == [False, False, True] * 2
    assert all(name in table.out for name in names)


def test_inspect_prints_json_of_what_is_bad_too(logs):
    (logs / "lifting-02.csv").write_text("")
    result = hitchid("inspect", logs, "--json", "--strict")
    assert (result.code, result.err) == (2, "")
    content = json.loads(result.out)
    assert len(content["records"]) == 5
    assert "lifting-02.csv" in content["faults"][0]
    lenient = json.loads(hitchid("inspect", logs, "--json").out)
    assert [log["name"] for log in lenient["left_out"]] == ["lifting-02"]
    assert lenient["faults"] == []


def test_inspect_draws_mixed_logs(tests_with_a_cycle, tmp_path):
    picture = tmp_path / "logs.png"
    arguments = ("inspect", tests_with_a_cycle, "--draw", picture)
    result = hitchid(*arguments)
    assert (result.code, result.err) == (0, "")
    assert picture.read_bytes().startswith(b"\x89PNG")
    taken = hitchid(*arguments)
    assert taken.code == 2
    assert "exists already" in taken.err


def test_a_picture_that_cannot_be_drawn_is_refused(refused, bench_folder, tests_with_a_cycle, tmp_path):
    for name in ("logs.txt", "logs", "logs.PNG.gz"):
        said = ["--draw", ".png, .svg, .pdf", f"'{name}'"]
        refused("inspect", tests_with_a_cycle, "--draw", tmp_path / name, said=said)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "a.csv").write_text("time_s\n")
    said = ["--draw", "none of the logs can be used"]
    refused("inspect", tmp_path / "broken", "--draw", tmp_path / "logs.png", said=said)


def test_run_answers_every_line_with_one(tmp_path):
    save(handmade.hitch("integrator"), tmp_path / "model")
    lines = [
        '{"time_s": 0.0, "lifting_command": 0.5, "lowering_command": 0.0, "displacement": 100.0}',
        "nonsense",
        "",
        '{"time_s": 0.02, "lifting_command": 0.5, "lowering_command": 0.0, "displacement": 100.1}',
    ]
    result = hitchid("run", tmp_path / "model", stdin="\n".join([*lines, ""]))
    assert (result.code, result.err) == (0, "ready\n")
    first, odd, blank, last = (json.loads(line) for line in result.out.splitlines())
    # A gain of 30 mm/(s A) moves the piston by 0.045 mm a sample at 0.15 A beyond the dead zone.
    assert first == {
        "time_s": 0.01,
        "displacement": pytest.approx(100.045, rel=1e-12),
        "mode": "lifting",
        "flags": [],
    }
    assert "not understood: the line is not JSON" in odd["flags"]
    assert odd["displacement"] == pytest.approx(100.09, rel=1e-12)
    assert blank["flags"] == odd["flags"]
    assert (last["displacement"], last["flags"]) == (pytest.approx(100.145, rel=1e-12), [])


def test_run_starts_where_it_is_told_to(tmp_path):
    save(handmade.hitch("integrator"), tmp_path / "model")
    result = hitchid("run", tmp_path / "model", "--initial", "50", stdin="{}\n")
    assert json.loads(result.out)["displacement"] == 50.0


def test_run_refuses_what_it_cannot_start_from(refused, model, tmp_path):
    refused("run", tmp_path / "missing", said=["model.json", "expected a model folder"])
    refused("run", model, "--initial", "nan", said=["displacement", "expected a finite number"])


@pytest.mark.parametrize("horizon", ["free", "3"])
def test_simulate_writes_what_the_model_predicts(bench_folder, tmp_path, horizon):
    hitch = handmade.hitch("integrator")
    save(hitch, tmp_path / "model")
    log, out = bench_folder / "lowering-02.csv", tmp_path / "out.csv"
    result = hitchid("simulate", tmp_path / "model", log, "--out", out, "--horizon", horizon)
    (record,) = read(log).records
    assert result == (0, "", f"{out}: {len(record)} samples, displacement predicted in mm\n")
    predicted = hitch.simulate(record).displacement if horizon == "free" else hitch.predict(record, horizon=3)
    header, *rows = (line.split(",") for line in out.read_text().splitlines())
    assert header == [*log.read_text().splitlines()[0].split(","), "displacement_predicted_mm"]
    # Nine significant digits are written.
    np.testing.assert_allclose([float(row[-1]) for row in rows], predicted, rtol=5e-9)
    again = hitchid("simulate", tmp_path / "model", log, "--out", out, "--force")
    assert again.code == 0


def test_simulate_says_where_it_leaves_the_identified_range(bench_folder, tmp_path):
    (record,) = read(bench_folder / "lifting-02.csv").records
    effective = np.maximum(record.command("lifting") - handmade.DEAD_ZONES["lifting"], 0)
    covered = handmade.envelope(command=(0.0, 0.05), displacement=(-50.0, 500.0))
    save(handmade.hitch("integrator", free_run=True, covered=covered), tmp_path / "model")
    log, out = bench_folder / "lifting-02.csv", tmp_path / "out.csv"
    arguments = ("simulate", tmp_path / "model", log, "--out", out)
    result = hitchid(*arguments)
    assert (result.code, result.out) == (0, "")
    samples = np.count_nonzero(effective > 0.05)
    assert samples > 0
    assert result.err == (
        "notice: lifting: the command is outside the identified range, 0 to 0.05 A beyond the dead zone, "
        f"in {samples} of {len(record)} samples\n"
        f"{out}: {len(record)} samples, displacement predicted in mm\n"
    )
    ahead = hitchid(*arguments, "--force", "--horizon", "3")
    assert ahead.code == 0
    assert "notice" not in ahead.err


def write_commands(path, commands):
    """Write a log of commands alone."""
    rows = [f"{0.01 * number:.2f},{up},{down}" for number, (up, down) in enumerate(commands)]
    path.write_text("\n".join(["time_s,current_up_A,current_down_A", *rows, ""]))
    return path


def test_simulate_takes_commands_alone_and_writes_prediction_and_band(tmp_path):
    hitch = handmade.with_bands(handmade.hitch("integrator"), "lifting", "lowering")
    save(hitch, tmp_path / "model")
    commands = np.zeros((60, 2))
    commands[10:40, 0] = 0.8
    log, out = write_commands(tmp_path / "commands.csv", commands.tolist()), tmp_path / "out.csv"
    arguments = ("simulate", tmp_path / "model", log, "--initial", "120", "--out", out)
    result = hitchid(*arguments, "--bands", "--coverage", "80")
    assert result == (0, "", f"{out}: 60 samples, displacement predicted in mm\n")
    header, *written = (line.split(",") for line in out.read_text().splitlines())
    added = [f"displacement_{kind}_mm" for kind in ("predicted", "lower", "upper")]
    assert header == ["time_s", "current_up_A", "current_down_A", *added]
    run = hitch.simulate(commands, step_s=0.01, initial=120.0)
    # Nine significant digits are written.
    np.testing.assert_allclose(
        np.array(written, float)[:, 3:].T, [run.displacement, *run.band(0.8)], rtol=5e-9
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), ["column 'displacement_mm'", "--initial"]),
        (("--initial", "120", "--horizon", "3"), ["3 samples ahead", "--initial", "--horizon free"]),
        (("--load", "80", "--horizon", "3"), ["3 samples ahead", "--load"]),
        (("--initial", "120", "--load", "80"), ["load: the model has no covariate"]),
        (("--initial", "nan"), ["initial: expected one or several numbers", "nan"]),
        (("--initial", "120", "--coverage", "80"), ["--coverage", "--bands"]),
        (
            ("--initial", "120", "--bands"),
            ["no bands for lifting and lowering; identification needs at least three tests"],
        ),
    ],
)
def test_simulate_refuses_options_that_do_not_fit(refused, model, tmp_path, options, said):
    log = write_commands(tmp_path / "commands.csv", [(0.8, 0)] * 30)
    refused("simulate", model, log, "--out", tmp_path / "out.csv", *options, said=said)


def test_design_of_a_model_that_knows_nothing_is_refused(refused, model, tmp_path):
    refused("design", model, "--direction", "lifting", "--out", tmp_path / "next.csv", said=["got lifting"])


@pytest.fixture(scope="module")
def tests_with_a_cycle(bench_folder, tmp_path_factory):
    """Return the bench's logs and one of both directions, up for a second and down for a second."""
    return benches.with_a_cycle(bench_folder, tmp_path_factory.mktemp("cycles") / "logs")


@pytest.fixture(scope="module")
def validated(tests_with_a_cycle, model, tmp_path_factory):
    """Return what two validations printed, as tables and as JSON, and the folder they wrote."""
    out = tmp_path_factory.mktemp("validated") / "out"
    arguments = ("validate", model, tests_with_a_cycle, "--out", out)
    return hitchid(*arguments), hitchid(*arguments, "--force", "--json"), out


@pytest.fixture
def metrics(validated):
    return json.loads((validated[2] / "metrics.json").read_text())


def test_validate_shows_a_summary_or_prints_the_metrics_it_writes(validated, metrics):
    shown, printed, out = validated
    assert (shown.code, printed.code) == (0, 0)
    for mode in ("lifting", "lowering"):
        assert f"{mode}, RMSE / mm" in shown.out
        assert f"{mode}: accuracy on 3 unseen tests" in (out / "tables.md").read_text()
    assert max(map(len, shown.out.splitlines())) <= 80
    assert "report.html" in shown.out
    assert json.loads(printed.out) == metrics


def test_validate_writes_a_report_with_its_figures(validated):
    out = validated[2]
    written = {"metrics.json", "tables.md", "tables", "report.html", "figures", MANIFEST_FILE}
    assert {path.name for path in out.iterdir()} == written
    page = (out / "report.html").read_text()
    assert page.startswith("<!doctype html>")
    assert "hitchid validate" in page
    for path in (out / "figures").iterdir():
        assert f'id="figure-{path.stem}"' in page


def test_tables_and_the_data_of_figures_are_csv(validated, metrics):
    out = validated[2]
    figures = {path.stem for path in (out / "figures").glob("*.svg")}
    assert {path.stem for path in (out / "figures").glob("*.csv")} == figures
    with (out / "tables" / "lifting-accuracy.csv").open() as file:
        rows = list(csv.DictReader(file))
    rmse = {(row["model"], row["run"]): row["rmse_mm"] for row in rows}
    lifting = metrics["channels"]["lifting"]
    assert float(rmse["greybox", "free_run"]) == lifting["greybox"]["free_run"]["rmse"]


def test_other_forms_of_the_report_are_written_on_request(bench_folder, model, tmp_path):
    pytest.importorskip("xlsxwriter")
    pytest.importorskip("typst")
    out, forms = tmp_path / "out", ("--xlsx", "--interactive", "--pdf")
    assert hitchid("validate", model, bench_folder, "--out", out, *forms, "--quiet") == (0, "", "")
    assert zipfile.is_zipfile(out / "tables.xlsx")
    assert "lifting-01" in (out / "interactive.html").read_text()
    assert (out / "report.pdf").read_bytes().startswith(b"%PDF")


def test_a_workbook_without_its_package_is_refused_before_any_work(
    refused, bench_folder, model, tmp_path, monkeypatch
):
    monkeypatch.setattr("hitchid.report.write.find_spec", lambda name: None)
    for command in (("validate", model), ("compare", model, model)):
        arguments = (*command, bench_folder, "--out", tmp_path / "out", "--xlsx")
        refused(*arguments, said=["pip install 'hitchid[xlsx]'"])


LIMITS = 'unit = "mm"\n[lifting]\ntests = 3\nfree_run = {{ rmse = {rmse} }}\n'


@pytest.mark.parametrize(
    ("rmse", "code", "verdict"), [pytest.param("1e6", 0, "pass", marks=pytest.mark.long), ("1e-6", 1, "fail")]
)
def test_limits_decide_on_the_exit_code(bench_folder, model, tmp_path, rmse, code, verdict):
    (tmp_path / "limits.toml").write_text(LIMITS.format(rmse=rmse))
    out, junit = tmp_path / "out", tmp_path / "results.xml"
    limits = ("--accept", tmp_path / "limits.toml", "--junit", junit)
    result = hitchid("validate", model, bench_folder, "--out", out, *limits)
    assert result.code == code
    assert all(line.startswith(("pass  ", "fail  ")) for line in result.out.splitlines()[-2:])
    assert result.out.splitlines()[-1].startswith(f"{verdict}  lifting: free run, RMSE")
    suite = ElementTree.parse(junit).getroot()  # noqa: S314 - our own
    assert (suite.get("tests"), suite.get("failures")) == ("2", str(code))
    assert (out / "report.html").read_text().count("<h2>Acceptance</h2>") == 1
    # Quietly it says what fails, and nothing where nothing does; as JSON it says all.
    quiet = hitchid("validate", model, bench_folder, "--out", out, *limits, "--force", "--quiet")
    assert (quiet.code, quiet.err, len(quiet.out.splitlines())) == (code, "", code)
    if code:
        printed = hitchid("validate", model, bench_folder, "--out", out, *limits, "--force", "--json")
        assert printed.code == code
        assert json.loads(printed.out)["acceptance"]["passed"] is False


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--junit", "results.xml"), ["--junit", "--accept"]),
        (("--accept", "nowhere.toml"), ["nowhere.toml"]),
        (("--accept", "bar.toml"), ["bar.toml", "rmse", "-1"]),
        (("--accept", "radians.toml"), ["rad", "mm"]),
    ],
)
def test_limits_that_cannot_be_held_are_refused(refused, bench_folder, model, tmp_path, options, said):
    (tmp_path / "bar.toml").write_text(LIMITS.format(rmse="-1"))
    (tmp_path / "radians.toml").write_text(LIMITS.format(rmse="1").replace("mm", "rad"))
    option, name = options
    refused("validate", model, bench_folder, "--out", tmp_path / "out", option, tmp_path / name, said=said)


@pytest.mark.long
def test_two_models_are_compared_on_tests_neither_has_seen(tests_with_a_cycle, model, tmp_path):
    save(handmade.hitch("integrator-first-order", baselines=True), tmp_path / "other")
    out = tmp_path / "out"
    arguments = ("compare", model, tmp_path / "other", tests_with_a_cycle, "--out", out)
    shown = hitchid(*arguments)
    assert shown.code == 0
    written = {"comparison.json", "tables.md", "tables", "report.html", "figures", MANIFEST_FILE}
    assert {path.name for path in out.iterdir()} == written
    assert all(f"{part}, RMSE / mm" in shown.out for part in ("lifting", "lowering", "cycles"))
    assert max(map(len, shown.out.splitlines())) <= 80
    printed = hitchid(*arguments, "--force", "--json")
    assert json.loads(printed.out) == json.loads((out / "comparison.json").read_text())
    assert set(json.loads(printed.out)["better"]) == {"lifting", "lowering", "cycles"}


@pytest.mark.long
def test_any_number_of_models_is_compared_before_the_logs(tests_with_a_cycle, model, tmp_path):
    others = [tmp_path / "other", tmp_path / "third"]
    for folder, structure in zip(others, ("integrator-first-order", "first-order-lag"), strict=True):
        save(handmade.hitch(structure, baselines=True), folder)
    out = tmp_path / "out"
    shown = hitchid("compare", model, *others, tests_with_a_cycle, "--out", out)
    assert shown.code == 0
    content = json.loads((out / "comparison.json").read_text())
    assert content["models"] == dict(zip("ABC", map(str, (model, *others)), strict=True))
    assert {"unit", "left_out", "A", "B", "C", "better", "leaderboard"} <= set(content)
    for rows in content["leaderboard"].values():
        assert sorted(row["model"] for row in rows) == ["A", "B", "C"]


def test_models_come_first_and_logs_follow(refused, tests_with_a_cycle, model, tmp_path):
    out, logs = tmp_path / "out", tests_with_a_cycle
    for arguments, said in (
        ((model,), ["two or more model folders", str(model)]),
        ((model, logs), [str(logs), "is not a model folder"]),
        ((logs, model, model), [str(logs), "is not a model folder"]),
        ((model, tmp_path / "nope", logs), [str(tmp_path / "nope"), "is not a model folder"]),
        ((model, model), ["expected logs after the 2 model folders, got none"]),
        ((model, model, logs), [f"two models are called '{model}'"]),
    ):
        refused("compare", *arguments, "--out", out, said=said)


def test_the_metrics_have_the_keys_of_the_contract(metrics):
    assert set(metrics) == {"unit", "channels", "cycles"}
    assert metrics["unit"] == "mm"
    assert set(metrics["channels"]) == {"lifting", "lowering"}
    both = {"one_step": FIGURES, "free_run": FIGURES}
    one_step, free_run = {"one_step": FIGURES}, {"free_run": FIGURES}
    for mode, channel in metrics["channels"].items():
        parts = ("tests", "benchmark", "greybox", "baselines", "horizons", "per_test", "residuals")
        assert set(channel) == set(parts)
        assert channel["tests"] == [f"{mode}-{number:02d}" for number in (1, 2, 3)]
        assert shape(channel["benchmark"]) == free_run
        assert shape(channel["greybox"]) == both
        assert {name: shape(runs) for name, runs in channel["baselines"].items()} == {
            **{"persistence": one_step, "arx": both, "oe": free_run, "narx": both},
            **{"lstm": free_run, "transfer_function": free_run, "paper": both},
        }
        assert {name: shape(runs) for name, runs in channel["per_test"].items()} == dict.fromkeys(
            channel["tests"], free_run
        )
        horizons = channel["horizons"]
        assert set(horizons) == {"steps", "greybox", "benchmark", *channel["baselines"]}
        assert horizons["steps"] == [1, 2, 5, 10, 20, 50, 100]
        assert {len(errors) for errors in horizons.values()} == {7}
        assert horizons["greybox"][0] == channel["greybox"]["one_step"]["rmse"]
        for name, baseline in channel["baselines"].items():
            assert "one_step" not in baseline or horizons[name][0] == baseline["one_step"]["rmse"]
    cycles = metrics["cycles"]
    assert cycles["tests"] == ["cycle-01"]
    models = {"greybox": both, "benchmark": free_run, "transfer_function": free_run, "persistence": one_step}
    assert {name: shape(cycles[name]) for name in models} == models
    assert set(cycles) == {"tests", *models, "horizons", "per_test", "max_jump"}
    assert set(cycles["horizons"]) == {"steps", "greybox", "persistence"}
    assert {len(errors) for errors in cycles["horizons"].values()} == {7}
    assert shape(cycles["per_test"]) == {"cycle-01": {"free_run"}}


def shape(runs):
    return {run: set(figures) for run, figures in runs.items()}


@pytest.mark.long
def test_a_name_without_unicode_is_validated_or_refused(bench_folder, model, tmp_path):
    folder = shutil.copytree(bench_folder, tmp_path / "logs")
    (folder / "lifting-03.csv").rename(folder / "lifting-\udcff.csv")
    result = hitchid("validate", model, folder, "--out", tmp_path / "out", "--json")
    assert result.code in (0, 2)
    assert (tmp_path / "out").exists() == (result.code == 0)


def test_identify_writes_a_model_and_prints_what_it_found(bench_folder, tmp_path):
    (tmp_path / "quick.toml").write_text(QUICK)
    out = tmp_path / "model"
    arguments = ("identify", bench_folder, "--out", out, "--config", tmp_path / "quick.toml", "--seed", "3")
    shown = hitchid(*arguments)
    assert shown.code == 0
    written = {"model.json", "weights.safetensors", "trace.json", MANIFEST_FILE}
    assert {path.name for path in out.iterdir()} == written
    assert all(word in shown.out for word in ("lifting", "lowering", "dead zone", "mm/(s·A)"))
    assert max(map(len, shown.out.splitlines())) <= 80
    assert "lowering: training the correction" in shown.err
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    assert json.loads(first["model.json"])["seed"] == 3
    printed = hitchid(*arguments, "--force", "--json")
    assert printed.code == 0
    assert json.loads(printed.out) == json.loads(first["trace.json"])
    assert {path.name: path.read_bytes() for path in out.iterdir()} == first
    used_all = hitchid("validate", out, bench_folder / "lifting-01.csv", "--out", tmp_path / "out")
    assert used_all.code == 2
    assert "was used for identification" in used_all.err


def test_a_failed_run_exits_with_1_and_leaves_nothing(bench_folder, tmp_path, monkeypatch):
    def fails(*_):
        raise FitError("the piston does not move")

    monkeypatch.setattr("hitchid.estimation.objective._speed_per_command", fails)
    (tmp_path / "quick.toml").write_text(QUICK)
    out = tmp_path / "model"
    result = hitchid("identify", bench_folder, "--out", out, "--config", tmp_path / "quick.toml")
    assert result.code == 1
    assert result.err.splitlines()[-1] == "hitchid: the piston does not move"
    assert not out.exists()


def test_rivals_there_are_or_of_other_logs_are_refused(refused, model, bench_folder, tmp_path):
    trained = handmade.hitch("integrator", compensated=True, baselines=True)
    rivals = {name: replace(own, trained=True) for name, own in trained.rivals.items()}
    save(replace(trained, rivals=rivals), tmp_path / "model")
    refused("rivals", tmp_path / "model", bench_folder, said=["has trained rivals already"])
    said = ["expected the logs and the split that it was identified from"]
    refused("rivals", model, bench_folder, said=said)


@pytest.mark.long
def test_rivals_are_trained_beside_a_model_and_compared(bench_folder, tmp_path):
    (tmp_path / "quick.toml").write_text(QUICK)
    logs, model = sorted(bench_folder.glob("lifting-*")), tmp_path / "model"
    hitchid("identify", *logs, "--out", model, "--config", tmp_path / "quick.toml", "--quiet")
    before = (model / "model.json").read_bytes()
    shown = hitchid("rivals", model, *logs)
    assert shown.code == 0, shown.err
    assert (model / "model.json").read_bytes() == before
    hitchid("validate", model, *logs, "--out", tmp_path / "results", "--quiet")
    metrics = json.loads((tmp_path / "results" / "metrics.json").read_text())
    assert {"arx", "oe", "lstm", "transfer_function"} <= metrics["channels"]["lifting"]["baselines"].keys()
