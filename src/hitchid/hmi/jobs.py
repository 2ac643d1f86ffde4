"""Jobs: commands of the command line, run as processes in the project folder, with their progress."""

import asyncio
import contextlib
import json
import os
import shlex
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError

from hitchid._support.processes import module_command, module_environment
from hitchid.errors import HitchError, InputError
from hitchid.hmi import project
from hitchid.hmi.campaign_files import SETTINGS
from hitchid.hmi.plans import Name
from hitchid.logs import StrictSettings, describe_settings

BRIEF = "brief.toml"  # settings of a brief identification, written into the project
LINES = 200  # of standard error that are kept
POINTS = 1000  # of a curve; above it every second one is dropped
MOST_RESULT = 4_000_000  # characters of a result; a longer one is not shown
LINE_BYTES = 2**20  # longest line of standard error
NICE = 5  # lower priority than the bench loop
OOM_SCORE = "500"  # of 1000: where memory runs out the system ends a job before the bench loop; chosen
SHORTEST_S = 0.2  # s between messages about a running job: five a second
LONGEST_END_S = 5.0  # s that a command may take to end when it is asked to; chosen
MOST_JOBS = 50  # that are remembered
INSPECT_FOUND_PROBLEMS = 1  # exit code of `hitchid inspect`, whose result is complete nevertheless


class Inspect(StrictSettings):
    """Audit of the logs of a campaign."""

    kind: Literal["inspect"]
    logs: str


class Identify(StrictSettings):
    """A model from the logs of a campaign."""

    kind: Literal["identify"]
    logs: str
    name: Name
    brief: bool = False


class Validate(StrictSettings):
    """A report of a model on tests that were not used for it."""

    kind: Literal["validate"]
    model: str
    logs: str
    name: Name


class Design(StrictSettings):
    """The test that helps a model most."""

    kind: Literal["design"]
    model: str
    direction: Literal["lifting", "lowering"]
    name: Name


class Tune(StrictSettings):
    """A position controller for a model."""

    kind: Literal["tune"]
    model: str
    name: Name


Request = Inspect | Identify | Validate | Design | Tune
_REQUEST: TypeAdapter[Request] = TypeAdapter(Annotated[Request, Field(discriminator="kind")])


def read_request(content: object, root: Path) -> tuple[Request, list[str], str]:
    """Return a request, the arguments of its command, and what it writes, relative to the project.

    Raises:
        InputError: a key is missing, unknown or wrong, or a path is not in the project.
    """
    try:
        request = _REQUEST.validate_python(content)
    except ValidationError as error:
        raise InputError(f"job: {describe_settings(error)}") from error
    # Else a path could be an option of the command, or lie outside of the project.
    for name in ("logs", "model"):
        if hasattr(request, name):
            project.inside(root, getattr(request, name))
    further: list[str] = []
    match request:
        case Inspect():
            return request, [request.kind, request.logs, "--json"], ""
        case Identify():
            inputs, out = [request.logs], f"{project.MODELS}/{request.name}"
            further = ["--config", BRIEF] if request.brief else []
            if not request.brief and (root / request.logs / SETTINGS).is_file():
                further = ["--config", f"{request.logs}/{SETTINGS}"]
        case Validate():
            inputs, out = [request.model, request.logs], f"{project.REPORTS}/{request.name}"
        case Design():
            inputs = [request.model, "--direction", request.direction]
            out = f"{project.UPLOADS}/{request.name}.csv"
        case Tune():
            inputs, out = [request.model], f"{project.CONTROLLERS}/{request.name}.toml"
            further = ["--report", f"{project.CONTROLLERS}/{request.name}-report"]
    return request, [request.kind, *inputs, "--out", out, *further, "--json"], out


@dataclass
class Job:
    """A command while it runs and after it: its state is running, done, failed or stopped.

    What it writes (`out`) is relative to the project.
    """

    number: int
    kind: str
    arguments: list[str]
    out: str
    state: str = "running"
    exit_code: int | None = None
    fraction: float = 0.0
    stage: str = ""
    result: object = None
    begin_s: float = field(default_factory=time.monotonic)
    lines: deque[str] = field(default_factory=lambda: deque(maxlen=LINES))
    curves: dict[str, list[tuple[int, float]]] = field(default_factory=dict)
    process: asyncio.subprocess.Process | None = None

    def describe(self) -> dict[str, object]:
        """Return the job as a message to the page; the time left is estimated."""
        elapsed_s = time.monotonic() - self.begin_s
        is_known = self.state == "running" and self.fraction > 0.02
        return {
            "type": "job",
            "id": self.number,
            "kind": self.kind,
            "command": shlex.join(["hitchid", *self.arguments]),
            "state": self.state,
            "exit_code": self.exit_code,
            "fraction": self.fraction,
            "left_s": elapsed_s * (1 - self.fraction) / self.fraction if is_known else None,
            "stage": self.stage,
            "lines": list(self.lines),
            "curves": self.curves,
            "result": self.result,
            "out": self.out,
        }

    def take_line(self, line: str) -> bool:
        """Take a line of standard error, progress as JSON or text; return whether it reports a result."""
        with contextlib.suppress(ValueError, TypeError, KeyError, OverflowError):
            update = json.loads(line)["progress"]
            self.fraction = max(self.fraction, min(1.0, float(update["fraction"])))
            self.stage = str(update["stage"])
            iteration = str(update["iteration"]).rpartition(" ")[2]  # the number of "iteration 12"
            figures, task = update["figures"], str(update["task"])
            prefix = f"{task} {self.stage.removeprefix(f'{task}: ')}" if task else self.stage
            for name, value in figures.items() if isinstance(figures, dict) else ():
                curve = self.curves.setdefault(f"{prefix}: {name}", [])
                curve.append((int(iteration) if iteration.isdecimal() else len(curve), float(value)))
                if len(curve) > POINTS:
                    del curve[::2]  # the whole of a long search stays in sight
            message = str(update.get("message", ""))
            if message:
                self.lines.append(message)
            return bool(message)
        if line.strip():
            self.lines.append(line.rstrip())
        return False


class Jobs:
    """All jobs of a session in a project folder, one running at a time beside the bench.

    `publish` is called with each message about a job, `on_written` when a job has written something.
    """

    def __init__(
        self, root: Path, publish: Callable[[Mapping[str, object]], None], on_written: Callable[[], None]
    ) -> None:
        self._root, self._publish, self._on_written = root, publish, on_written
        self._jobs: dict[int, Job] = {}
        self._tasks: set[asyncio.Task] = set()
        self._number = 0

    def describe(self) -> list[dict[str, object]]:
        """Return all jobs as messages."""
        return [job.describe() for job in self._jobs.values()]

    def start(self, content: object) -> int:
        """Start a job and return its number.

        Raises:
            InputError: the request is wrong, or another job is running.
        """
        request, arguments, out = read_request(content, self._root)
        running = [job for job in self._jobs.values() if job.state == "running"]
        if running:
            raise InputError(f"hitchid {running[0].kind} is still running; wait for its end, or stop it")
        is_brief = isinstance(request, Identify) and request.brief
        self._number += 1
        job = self._jobs[self._number] = Job(self._number, request.kind, arguments, out)
        if len(self._jobs) > MOST_JOBS:
            del self._jobs[next(iter(self._jobs))]
        task = asyncio.get_running_loop().create_task(self._run(job, is_brief=is_brief))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return job.number

    def stop(self, number: int) -> None:
        """Stop a running job.

        Raises:
            InputError: there is none of this number.
        """
        job = self._jobs.get(number)
        if job is None or job.state != "running" or job.process is None:
            raise InputError(f"job {number}: is not running")
        job.state = "stopped"  # before it ends, which would count as a failure
        job.process.terminate()

    async def end(self) -> None:
        """Stop what runs, and wait for it; kill what does not end."""
        running = [job for job in self._jobs.values() if job.state == "running" and job.process is not None]
        for job in running:
            self.stop(job.number)
        if self._tasks:
            _, unfinished = await asyncio.wait(self._tasks, timeout=LONGEST_END_S)
            for process in (job.process for job in running if unfinished):  # one that ignores the request
                if process is not None:
                    with contextlib.suppress(ProcessLookupError):
                        process.kill()
            for task in unfinished:
                task.cancel()

    async def _run(self, job: Job, *, is_brief: bool) -> None:
        try:
            # In a thread, as what the bench loop hears from this process must not wait for a disk.
            await asyncio.to_thread(self._prepare, job.out, is_brief=is_brief)
            await self._carry_out(job)
        except (OSError, HitchError) as error:
            problem = error.strerror if isinstance(error, OSError) else error
            job.state = "failed"
            job.lines.append(f"hitchid {job.kind}: cannot be started: {problem}")
            self._publish(job.describe())

    def _prepare(self, out: str, *, is_brief: bool) -> None:
        """Check where a job writes to, and write the settings of a brief identification if there are none."""
        if out:
            project.place(self._root, out)
        if is_brief and not os.path.lexists(self._root / BRIEF):
            settings = resources.files("hitchid.hmi").joinpath(BRIEF).read_bytes()
            project.write_new(self._root, BRIEF, settings)

    async def _carry_out(self, job: Job) -> None:
        job.process = await asyncio.create_subprocess_exec(
            *module_command("hitchid", *job.arguments),
            cwd=self._root,
            env={**module_environment(), "HITCHID_PROGRESS": "json", "NO_COLOR": "1"},
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=LINE_BYTES,
        )
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, job.process.pid, NICE)
            Path(f"/proc/{job.process.pid}/oom_score_adj").write_text(OOM_SCORE)
        assert job.process.stdout is not None  # noqa: S101 - both are pipes
        # Both pipes at once: a command waits for ever on one that is full and not read.
        output, _, _ = await asyncio.gather(
            job.process.stdout.read(), self._read_progress(job), job.process.wait()
        )
        job.exit_code = job.process.returncode
        has_result = job.exit_code == 0 or (job.kind == "inspect" and job.exit_code == INSPECT_FOUND_PROBLEMS)
        if has_result and len(output) < MOST_RESULT:
            with contextlib.suppress(ValueError):
                job.result = json.loads(output)
        if job.state == "running":
            job.state = "done" if has_result else "failed"
        job.fraction = 1.0 if job.state == "done" else job.fraction
        self._publish(job.describe())
        self._on_written()  # also of a job that failed or was stopped: its physics model may be saved

    async def _read_progress(self, job: Job) -> None:
        assert job.process is not None  # noqa: S101 - called for a job that runs
        assert job.process.stderr is not None  # noqa: S101
        published_s = 0.0
        while not job.process.stderr.at_eof():
            with contextlib.suppress(ValueError):  # longer than LINE_BYTES: left out
                line = (await job.process.stderr.readline()).decode(errors="replace")
                if job.take_line(line):  # such as the physics model, before its corrections
                    self._on_written()
            if time.monotonic() - published_s >= SHORTEST_S:
                self._publish(job.describe())
                published_s = time.monotonic()
