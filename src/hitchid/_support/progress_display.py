"""Progress of long work as it is shown.

On a terminal a bar and sparklines of the minimised figures, in a notebook a bar, else a line per stage or,
from a script, nothing. With `HITCHID_PROGRESS=json` in the environment the command line writes lines of JSON,
for programs that show it themselves.
"""

import json
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite, log

from rich.console import Group
from rich.live import Live
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.text import Text

from hitchid._support import checks
from hitchid._support.console import PlainConsole, line
from hitchid._support.inert import html_text
from hitchid._support.progress import ProgressCallback, ProgressUpdate, silent

FORMAT_VARIABLE = "HITCHID_PROGRESS"
SHORTEST_S = 0.1  # s between lines of JSON of one stage; chosen: faster than anyone reads
KNOWN_FRACTION, KNOWN_S = 0.05, 5.0  # of the work, and s, from which on the time left is estimated; chosen
BLOCKS = "▁▂▃▄▅▆▇█"
WIDTH, NAME = 36, 28  # characters of a sparkline and of its name, for 80 columns


@contextmanager
def shown(progress: ProgressCallback | bool | None) -> Iterator[ProgressCallback]:
    """Yield the callback of a public function: its own, or for True a bar where somebody watches.

    Raises:
        InputError: it is neither True, False or None nor can be called.
    """
    if not (progress is None or isinstance(progress, bool) or callable(progress)):
        raise checks.input_error("progress", "True, False or a function of a progress update", progress)
    if progress is not None and not isinstance(progress, bool):
        yield progress
    elif progress and "ipykernel" in sys.modules:
        yield _NotebookBar().report
    elif progress and sys.stderr is not None and sys.stderr.isatty():
        with _terminal_bar() as report:
            yield report
    else:
        yield silent


@contextmanager
def progress(*, quiet: bool = False) -> Iterator[ProgressCallback]:
    """Yield a callback that shows the progress of a command on stderr; none if `quiet`."""
    if quiet:
        yield silent
    elif os.environ.get(FORMAT_VARIABLE) == "json":
        yield _JsonLines().report
    elif sys.stderr.isatty():
        with _terminal_bar() as report:
            yield report
    else:
        lines = _Lines()
        yield lines.report
        lines.end()


@contextmanager
def _terminal_bar() -> Iterator[ProgressCallback]:
    bar = Bar(
        BarColumn(24),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}", markup=False),
    )
    task = bar.add_task("", total=1.0)
    curves = Curves()
    console = PlainConsole(stderr=True)
    with Live(Group(bar, curves), console=console, transient=True, refresh_per_second=8):

        def show(step: ProgressUpdate) -> None:
            if step.message:
                console.print(step.message)
            curves.update(step)
            bar.update(task, description=curves.stages, completed=step.fraction)

        yield show


class _NotebookBar:
    """A bar with the present stage, replaced in the output of its cell; messages stay below it."""

    def __init__(self) -> None:
        from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

        self._html, self._messages = HTML, ""
        self._handle = display(HTML(""), display_id=True)
        self._printed_s = 0.0

    def report(self, step: ProgressUpdate) -> None:
        now_s = time.monotonic()
        if now_s - self._printed_s < SHORTEST_S and not step.message and step.fraction < 1:
            return
        self._printed_s = now_s
        self._messages += f"<br>{html_text(step.message)}" if step.message else ""
        bar = f'<progress max="1" value="{step.fraction:.3f}"></progress> {html_text(step.stage)}'
        self._handle.update(self._html(bar + self._messages))


class Curves:
    """Sparklines of the figures that the present stage of each task minimises."""

    def __init__(self) -> None:
        self._tasks: dict[str, tuple[ProgressUpdate, dict[str, list[float]]]] = {}

    def update(self, step: ProgressUpdate) -> None:
        """Add an update; a new stage starts new sparklines, an update without task ends all tasks."""
        current_tasks = {name: entry for name, entry in self._tasks.items() if bool(name) == bool(step.task)}
        last, values = current_tasks.get(step.task, (step, {}))
        values = values if last.stage == step.stage else {}
        for name, value in step.figures.items():
            values.setdefault(name, []).append(value)
        self._tasks = {**current_tasks, step.task: (step, values)}

    @property
    def stages(self) -> str:
        """Names of the present stages."""
        return " | ".join(step.stage for step, _ in self._tasks.values())

    def __rich__(self) -> Text:
        """Return the iteration of each task and a line for each figure, in 80 columns."""
        lines = []
        for step, values in self._tasks.values():
            lines += [" ".join(filter(None, (step.task, step.iteration)))] if values else []
            for name, series in values.items():
                lines.append(f"{name[:NAME]:{NAME}} {series[-1]:<9.4g} {sparkline(series)}")
        return Text("\n".join(lines), no_wrap=True)


def sparkline(values: list[float]) -> str:
    """Return values as block characters, on a logarithmic scale if all are positive."""
    finite_values = [value for value in values if isfinite(value)]
    if not finite_values:
        return ""
    heights = [log(value) for value in finite_values] if min(finite_values) > 0 else finite_values
    resampled = [heights[round(index * (len(heights) - 1) / (WIDTH - 1))] for index in range(WIDTH)]
    shown = resampled if len(heights) > WIDTH else heights
    largest = max(map(abs, shown)) or 1.0  # avoids overflow in the difference of two very large values
    shown = [height / largest for height in shown]
    low, high = min(shown), max(shown)
    scale = (len(BLOCKS) - 1) / ((high - low) or 1.0)
    return "".join(BLOCKS[round((height - low) * scale)] for height in shown)


class _JsonLines:
    """Prints updates as JSON, `{"progress": {...}}` a line; those of one stage ten times a second at most."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[str, float]] = {}

    def report(self, step: ProgressUpdate) -> None:
        stage, printed_s = self._last.get(step.task, ("", 0.0))
        now_s = time.monotonic()
        if step.stage == stage and now_s - printed_s < SHORTEST_S and not step.message:
            return
        self._last[step.task] = step.stage, now_s
        # JSON knows neither NaN nor infinity.
        figures = {name: value for name, value in step.figures.items() if isfinite(value)}
        content = {**step._asdict(), "figures": figures}
        sys.stderr.write(f"{json.dumps({'progress': content})}\n")
        sys.stderr.flush()


class _Lines:
    """Prints messages, a line at the start of a stage with the time left, and one with its last figures."""

    def __init__(self) -> None:
        self._last: dict[str, ProgressUpdate] = {}
        self._begin_s = time.monotonic()

    def report(self, step: ProgressUpdate) -> None:
        last = self._last.get(step.task)
        if step.message:
            sys.stderr.write(line(step.message))
        elif last is None or step.stage != last.stage:
            self.end(*filter(None, [step.task]))
            elapsed_s, done, left = time.monotonic() - self._begin_s, step.fraction, ""
            if elapsed_s >= KNOWN_S and KNOWN_FRACTION < done < 1:
                left = f", about {max(elapsed_s * (1 - done) / done, 1):.0f} s left"
            sys.stderr.write(line(f"{done:4.0%}  {step.stage}{left}"))
        sys.stderr.flush()
        self._last[step.task] = step

    def end(self, *tasks: str) -> None:
        """Write the last figures of the given tasks, by default of all."""
        for task in tasks or tuple(self._last):
            last = self._last.pop(task, None)
            if last is not None and last.figures:
                figures_text = ", ".join(f"{name} {value:.4g}" for name, value in last.figures.items())
                stage = f"{task}, " if task else ""
                sys.stderr.write(line(f"      {stage}{last.iteration}: {figures_text}"))
                sys.stderr.flush()
