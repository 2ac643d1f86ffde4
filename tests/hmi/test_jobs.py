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
from hitchid.hmi.jobs import LINE_BYTES, LINES, POINTS, Job, Jobs, read_request


@pytest.fixture
def root(tmp_path):
    for folder in ("campaigns/a", "models/a"):
        (tmp_path / folder).mkdir(parents=True)
    return tmp_path


@pytest.mark.parametrize(
    ("content", "command", "out"),
    [
        ({"kind": "inspect", "logs": "campaigns/a"}, "inspect campaigns/a --json", ""),
        (
            {"kind": "identify", "logs": "campaigns/a", "name": "b"},
            "identify campaigns/a --out models/b --json",
            "models/b",
        ),
        (
            {"kind": "identify", "logs": "campaigns/a", "name": "b", "brief": True},
            "identify campaigns/a --out models/b --config brief.toml --json",
            "models/b",
        ),
        (
            {"kind": "validate", "model": "models/a", "logs": "campaigns/a", "name": "r"},
            "validate models/a campaigns/a --out reports/r --json",
            "reports/r",
        ),
        (
            {"kind": "design", "model": "models/a", "direction": "lifting", "name": "n"},
            "design models/a --direction lifting --out uploads/n.csv --json",
            "uploads/n.csv",
        ),
        (
            {"kind": "tune", "model": "models/a", "name": "c"},
            "tune models/a --out controllers/c.toml --report controllers/c-report --json",
            "controllers/c.toml",
        ),
    ],
)
def test_a_request_is_a_command(root, content, command, out):
    _, arguments, written = read_request(content, root)
    assert (" ".join(arguments), written) == (command, out)


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


def new_job():
    return Job(1, "identify", ["identify", "a b"], "models/a")


def line(fraction, iteration, stage="search", **figures):
    update = ProgressUpdate(stage, fraction, f"iteration {iteration}" if iteration else "", figures)
    return json.dumps({"progress": update._asdict()})


def test_progress_is_fraction_stage_and_curves():
    job = new_job()
    for k in range(1, 4):
        job.take_line(line(0.1 * k, k, rmse=1.0 / k))
    told = job.describe()
    assert (told["fraction"], told["stage"]) == (pytest.approx(0.3), "search")
    assert told["curves"] == {"search: rmse": [(1, 1.0), (2, 0.5), (3, 1 / 3)]}
    assert told["lines"] == []
    assert told["command"] == "hitchid identify 'a b'"
    assert told["left_s"] >= 0


def test_progress_never_goes_back_nor_beyond_the_whole():
    job = new_job()
    for fraction in (0.5, 0.2, 7.0, -1.0):
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


def test_an_empty_line_is_none():
    job = new_job()
    job.take_line("  \n")
    assert not job.lines


def test_lines_and_curves_are_bounded_and_keep_first_trend_and_last():
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
    new_job().take_line(text)


class Told(list):
    """Messages about jobs."""

    def last(self, state):
        return next(message for message in reversed(self) if message["state"] == state)


@pytest.fixture
def program(root, monkeypatch, tmp_path):
    """Return a function that runs a job whose command is a script, until it ended; and its messages."""

    def run(script, during=None, kind="inspect"):
        told = Told()
        module = tmp_path / "stand-in"
        (module / "hitchid").mkdir(parents=True, exist_ok=True)
        (module / "hitchid" / "__init__.py").touch()
        (module / "hitchid" / "__main__.py").write_text(script)

        async def main():
            all_jobs = Jobs(root, told.append, lambda: None)
            number = all_jobs.start({"kind": kind, "logs": "campaigns/a"})
            if during is not None:
                await during(all_jobs, number)
            while all_jobs.describe()[0]["state"] == "running" or all_jobs._tasks:
                await asyncio.sleep(0.01)

        with monkeypatch.context() as patch:
            patch.setattr(sys, "path", [str(module), *sys.path])
            asyncio.run(asyncio.wait_for(main(), 30))
        return told

    return run


def test_a_job_that_ends_well_is_done_with_its_result(program):
    told = program("import json; print(json.dumps({'logs': 3}))").last("done")
    assert (told["exit_code"], told["fraction"], told["result"]) == (0, 1.0, {"logs": 3})


def test_a_job_that_fails_keeps_its_last_lines(program):
    told = program("raise SystemExit('campaigns/a: holds no log')" + "\n").last("done")
    assert told["exit_code"] == 1  # of inspect, which found problems
    told = program("import sys; print('cannot', file=sys.stderr); sys.exit(2)").last("failed")
    assert (told["exit_code"], told["lines"], told["result"]) == (2, ["cannot"], None)


def test_a_very_long_line_does_not_end_a_job(program):
    script = (
        f"import sys; sys.stderr.write('x' * {3 * LINE_BYTES} + '\\n'); print('after', file=sys.stderr);"
        "print('{}')"
    )
    told = program(script).last("done")
    assert told["lines"][-1] == "after"


def test_a_job_can_be_stopped_and_another_started(program):
    async def stop(all_jobs, number):
        with pytest.raises(InputError, match="is still running"):
            all_jobs.start({"kind": "inspect", "logs": "campaigns/a"})
        while all_jobs.describe()[0]["lines"] == []:
            await asyncio.sleep(0.01)
        all_jobs.stop(number)
        with pytest.raises(InputError, match="is not running"):
            all_jobs.stop(number)

    script = "import sys, time; print('begun', file=sys.stderr, flush=True); time.sleep(60)"
    assert program(script, stop).last("stopped")["exit_code"] == -15


def test_a_job_that_is_none_cannot_be_stopped(root):
    with pytest.raises(InputError, match="job 7: is not running"):
        Jobs(root, print, print).stop(7)


def test_results_are_not_kept_without_end(program, monkeypatch):
    monkeypatch.setattr(jobs, "MOST_RESULT", 100)
    assert program("print([1] * 100)").last("done")["result"] is None


def test_the_command_line_tells_its_progress_as_json(capsys, monkeypatch):
    monkeypatch.setenv(FORMAT_VARIABLE, "json")
    updates = [ProgressUpdate("search", 0.5, "iteration 3", {"rmse": 0.25, "other": float("nan")}, "lifting")]
    updates += [ProgressUpdate("search", 0.6, "iteration 4", {}, "lifting")]  # too soon after the first
    updates += [ProgressUpdate("search", 0.6, "iteration 4", {}, "lowering")]
    updates += [ProgressUpdate("training", 0.7, "", {}, "lifting")]
    with progress() as report:
        for update in updates:
            report(update)
    output = capsys.readouterr()
    told = [json.loads(text)["progress"] for text in output.err.splitlines()]
    assert [(each["stage"], each["task"]) for each in told] == [
        ("search", "lifting"),
        ("search", "lowering"),
        ("training", "lifting"),
    ]
    assert told[0]["figures"] == {"rmse": 0.25}
    assert output.out == ""
    job = new_job()
    for text in output.err.splitlines():
        job.take_line(text)
    assert (job.fraction, job.stage, list(job.lines)) == (0.7, "training", [])


def test_quiet_tells_nothing(capsys, monkeypatch):
    monkeypatch.setenv(FORMAT_VARIABLE, "json")
    with progress(quiet=True) as report:
        report(ProgressUpdate("search", 0.5))
    assert capsys.readouterr().err == ""


def test_what_has_been_reached_is_a_line_and_tells_of_a_result():
    job = new_job()
    assert not job.take_line(line(0.1, 1, rmse=1.0))
    update = ProgressUpdate("physics model", 0.5, figures={}, message="physics model saved: RMSE 0.3 mm")
    assert job.take_line(json.dumps({"progress": update._asdict()}))
    assert job.describe()["lines"] == ["physics model saved: RMSE 0.3 mm"]


def state_after(root, content):
    """Return the state and the last line of a job once it has ended."""

    async def carried_out():
        jobs = Jobs(root, lambda _: None, lambda: None)
        jobs.start(content)
        await asyncio.wait(jobs._tasks)
        (job,) = jobs.describe()
        return job["state"], job["lines"][-1]

    return asyncio.run(carried_out())


@pytest.mark.parametrize(
    ("link", "content", "problem"),
    [
        (
            "reports",
            {"kind": "validate", "model": "models/a", "logs": "campaigns/a", "name": "r"},
            "is a link",
        ),
        ("controllers", {"kind": "tune", "model": "models/a", "name": "c"}, "is a link"),
        (
            "uploads/n.csv",
            {"kind": "design", "model": "models/a", "direction": "lifting", "name": "n"},
            "exists",
        ),
    ],
)
def test_no_job_writes_to_where_a_link_leads(root, link, content, problem):
    (root / "elsewhere").mkdir()
    (root / link).parent.mkdir(exist_ok=True)
    (root / link).symlink_to(root / "elsewhere" / "b" if "/" in link else root / "elsewhere")
    state, line = state_after(root, {**content, "model": "models/a", "name": "n"})
    assert state == "failed"
    assert problem in line
    assert list((root / "elsewhere").iterdir()) == []


def test_the_settings_of_a_brief_identification_are_not_written_through_a_link(root):
    (root / "brief.toml").symlink_to(root / "elsewhere.toml")
    Jobs(root, lambda _: None, lambda: None)._prepare("models/b", is_brief=True)
    assert not (root / "elsewhere.toml").exists()
