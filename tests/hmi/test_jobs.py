"""Jobs are commands of the command line: their arguments, their progress, their end."""

import asyncio
import json
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.progress import ProgressUpdate
from hitchid._support.progress_display import FORMAT_VARIABLE, progress
from hitchid.errors import InputError
from hitchid.hmi import jobs
from hitchid.hmi.campaign_files import SETTINGS
from hitchid.hmi.jobs import LINE_BYTES, LINES, POINTS, Job, Jobs, read_request


@pytest.fixture
def root(tmp_path):
    for folder in ("campaigns/a", "models/a"):
        (tmp_path / folder).mkdir(parents=True)
    return tmp_path


LOGS, MODEL = {"logs": "campaigns/a"}, {"model": "models/a"}


@pytest.mark.parametrize(
    ("command", "content"),
    [
        ("inspect campaigns/a --json", LOGS),
        ("identify campaigns/a --out models/b --json", {**LOGS, "name": "b"}),
        (
            "identify campaigns/a --out models/b --config brief.toml --json",
            {**LOGS, "name": "b", "brief": True},
        ),
        ("validate models/a campaigns/a --out reports/r --json", {**MODEL, **LOGS, "name": "r"}),
        (
            "design models/a --direction lifting --out uploads/n.csv --json",
            {**MODEL, "direction": "lifting", "name": "n"},
        ),
        (
            "tune models/a --out controllers/c.toml --report controllers/c-report --json",
            {**MODEL, "name": "c"},
        ),
    ],
)
def test_a_request_is_a_command(root, command, content):
    kind, *arguments = command.split()
    _, given, written = read_request({"kind": kind, **content}, root)
    assert given == [kind, *arguments]
    assert written == (arguments[arguments.index("--out") + 1] if "--out" in arguments else "")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ({}, "kind"),
        (None, "job: "),
        ([], "job: "),
        ({"kind": "rm"}, "kind"),
        ({"kind": ["identify"]}, "kind"),
        ({"kind": "inspect"}, "logs"),
        ({"kind": "inspect", "logs": "../.."}, "path"),
        ({"kind": "inspect", "logs": "--help"}, "path"),
        ({"kind": "inspect", "logs": "campaigns/none"}, "path"),
        ({"kind": "inspect", "logs": "campaigns/a", "argument": "--force"}, "argument"),
        ({"kind": "identify", "logs": "campaigns/a", "name": "../b"}, "name"),
        ({"kind": "identify", "logs": "campaigns/a", "name": "--force"}, "name"),
        ({"kind": "identify", "logs": "campaigns/a", "name": "b", "brief": "maybe"}, "brief"),
        ({"kind": "validate", "model": "/etc", "logs": "campaigns/a", "name": "r"}, "path"),
        ({"kind": "design", "model": "models/a", "direction": "up", "name": "n"}, "direction"),
    ],
)
def test_any_other_request_is_refused(root, content, problem):
    with pytest.raises(InputError, match=problem):
        read_request(content, root)


def test_a_campaign_of_few_tests_is_identified_by_its_settings(root):
    (root / "campaigns" / "a" / SETTINGS).write_text("")
    _, given, _ = read_request({"kind": "identify", "logs": "campaigns/a", "name": "b"}, root)
    assert given[given.index("--config") + 1] == f"campaigns/a/{SETTINGS}"


def new_job():
    return Job(1, "identify", ["identify", "a b"], "models/a")


def line(fraction, iteration, stage="search", **figures):
    update = ProgressUpdate(stage, fraction, f"iteration {iteration}" if iteration else "", figures)
    return json.dumps({"progress": update._asdict()})


def test_progress_is_fraction_stage_and_curves():
    job = new_job()
    for k in range(1, 4):
        job.take_line(line(0.1 * k, k, rmse=1.0 / k))
    content = job.describe()
    assert (content["fraction"], content["stage"]) == (pytest.approx(0.3), "search")
    assert content["curves"] == {"search: rmse": [(1, 1.0), (2, 0.5), (3, 1 / 3)]}
    assert content["lines"] == []
    assert content["command"] == "hitchid identify 'a b'"
    assert content["left_s"] >= 0
    for fraction in (0.5, 0.2, 7.0, -1.0):  # it never goes back, nor beyond the whole
        job.take_line(line(fraction, 1))
    assert job.fraction == 1.0


@pytest.mark.parametrize(
    "text",
    [
        "Traceback (most recent call last):",
        "[1]",
        "3",
        '{"progress": 3}',
        '{"progress": {"fraction": "half"}}',
        '{"progress": {"fraction": 0.1}}',
        '{"progress": {"fraction": 1' + 400 * "0" + ', "stage": "a", "iteration": "", "figures": {}}}',
        '{"other": {}}',
    ],
)
def test_what_is_no_progress_is_a_line(text):
    job = new_job()
    job.take_line(f"{text}\n")
    assert list(job.lines) == [text]


def test_lines_and_curves_are_bounded_and_keep_the_last():
    job = new_job()
    for k in range(1, 20 * POINTS):
        job.take_line(line(0.5, k, rmse=float(k)))
        job.lines.append(str(k))
    curve = job.curves["search: rmse"]
    assert len(job.lines) == LINES
    assert len(curve) <= POINTS
    assert [point[0] for point in curve] == sorted({point[0] for point in curve})
    assert curve[-1] == (20 * POINTS - 1, 20.0 * POINTS - 1)


@given(st.text(max_size=200))
def test_any_line_is_taken(text):
    job = new_job()
    job.take_line(text)
    assert bool(job.lines) == bool(text.strip()) or "progress" in text


@pytest.fixture
def program(root, monkeypatch, tmp_path):
    """Return a function that runs a job whose command is a script; it gives the last message about it."""

    def run(script, during=None, kind="inspect"):
        messages, package = [], tmp_path / "stand-in" / "hitchid"
        package.mkdir(parents=True, exist_ok=True)
        (package / "__init__.py").touch()
        (package / "__main__.py").write_text(script)

        async def main():
            all_jobs = Jobs(root, messages.append, lambda: None)
            number = all_jobs.start({"kind": kind, **LOGS})
            if during is not None:
                await during(all_jobs, number)
            while all_jobs.describe()[0]["state"] == "running" or all_jobs._tasks:
                await asyncio.sleep(0.01)

        with monkeypatch.context() as patch:
            patch.setattr(sys, "path", [str(package.parent), *sys.path])
            asyncio.run(asyncio.wait_for(main(), 30))
        return messages[-1]

    return run


@pytest.mark.parametrize(
    ("script", "expected"),
    [
        (
            "import json; print(json.dumps({'logs': 3}))",
            {"state": "done", "exit_code": 0, "fraction": 1.0, "result": {"logs": 3}},
        ),
        # Of inspect, which found problems.
        ("raise SystemExit('campaigns/a: holds no log')", {"state": "done", "exit_code": 1}),
        (
            "import sys; print('cannot', file=sys.stderr); sys.exit(2)",
            {"state": "failed", "exit_code": 2, "lines": ["cannot"], "result": None},
        ),
        (
            f"import sys; sys.stderr.write('x' * {3 * LINE_BYTES} + '\\nafter\\n'); print('{{}}')",
            {"state": "done", "lines": ["after"]},
        ),
        ("print([1] * 100)", {"state": "done", "result": None}),
    ],
    ids=["done", "problems", "failed", "a very long line", "a very long result"],
)
def test_a_job_ends_with_its_result_or_its_last_lines(program, monkeypatch, script, expected):
    monkeypatch.setattr(jobs, "MOST_RESULT", 100)
    last = program(script)
    last["lines"] = last["lines"][-1:]
    assert {name: last[name] for name in expected} == expected


def test_a_running_job_can_be_stopped_and_no_other(program):
    async def stop(all_jobs, number):
        with pytest.raises(InputError, match="is still running"):
            all_jobs.start({"kind": "inspect", **LOGS})
        while all_jobs.describe()[0]["lines"] == []:
            await asyncio.sleep(0.01)
        with pytest.raises(InputError, match="job 7: is not running"):
            all_jobs.stop(7)
        all_jobs.stop(number)
        with pytest.raises(InputError, match="is not running"):
            all_jobs.stop(number)

    script = "import sys, time; print('begun', file=sys.stderr, flush=True); time.sleep(60)"
    last = program(script, stop)
    assert (last["state"], last["exit_code"]) == ("stopped", -15)


def test_the_command_line_tells_its_progress_as_json(capsys, monkeypatch):
    monkeypatch.setenv(FORMAT_VARIABLE, "json")
    figures = {"rmse": 0.25, "other": float("nan")}
    with progress(quiet=True) as report:
        report(ProgressUpdate("search", 0.5))
    with progress() as report:
        report(ProgressUpdate("search", 0.5, "iteration 3", figures, "lifting"))
        report(ProgressUpdate("search", 0.6, "iteration 4", {}, "lifting"))  # too soon after the first
        report(ProgressUpdate("search", 0.6, "iteration 4", {}, "lowering"))
        report(ProgressUpdate("training", 0.7, "", {}, "lifting"))
    output = capsys.readouterr()
    updates = [json.loads(text)["progress"] for text in output.err.splitlines()]
    assert [(update["stage"], update["task"]) for update in updates] == [
        ("search", "lifting"),
        ("search", "lowering"),
        ("training", "lifting"),
    ]
    assert updates[0]["figures"] == {"rmse": 0.25}
    assert output.out == ""
    job = new_job()
    for text in output.err.splitlines():
        job.take_line(text)
    assert (job.fraction, job.stage, list(job.lines)) == (0.7, "training", [])


def test_what_has_been_reached_is_a_line_and_a_result():
    job = new_job()
    assert not job.take_line(line(0.1, 1, rmse=1.0))
    update = ProgressUpdate("physics model", 0.5, figures={}, message="physics model saved: RMSE 0.3 mm")
    assert job.take_line(json.dumps({"progress": update._asdict()}))
    assert job.describe()["lines"] == ["physics model saved: RMSE 0.3 mm"]


@pytest.mark.parametrize(
    ("link", "content", "problem"),
    [
        ("reports", {"kind": "validate", **LOGS}, "is a link"),
        ("controllers", {"kind": "tune"}, "is a link"),
        ("uploads/n.csv", {"kind": "design", "direction": "lifting"}, "exists"),
    ],
)
def test_no_job_writes_to_where_a_link_leads(root, link, content, problem):
    (root / "elsewhere").mkdir()
    (root / link).parent.mkdir(exist_ok=True)
    (root / link).symlink_to(root / "elsewhere" / "b" if "/" in link else root / "elsewhere")

    async def carried_out():
        all_jobs = Jobs(root, lambda _: None, lambda: None)
        all_jobs.start({**content, **MODEL, "name": "n"})
        await asyncio.wait(all_jobs._tasks)
        return all_jobs.describe()[0]

    job = asyncio.run(carried_out())
    assert job["state"] == "failed"
    assert problem in job["lines"][-1]
    assert list((root / "elsewhere").iterdir()) == []


def test_brief_settings_are_not_written_through_a_link(root):
    (root / "brief.toml").symlink_to(root / "elsewhere.toml")
    Jobs(root, lambda _: None, lambda: None)._prepare("models/b", is_brief=True)
    assert not (root / "elsewhere.toml").exists()
