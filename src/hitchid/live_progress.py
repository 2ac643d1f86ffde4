"""Progress on a terminal: a bar, and the figures that a stage makes smaller as they fall; lines elsewhere."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite, log

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.text import Text

from hitchid.progress import Progress, Step, silent

BLOCKS = "▁▂▃▄▅▆▇█"
WIDTH, NAME = 36, 28


@contextmanager
def progress(*, quiet: bool = False) -> Iterator[Progress]:
    """Give what shows progress on stderr: live on a terminal, a line a stage elsewhere, quietly nothing."""
    if quiet:
        yield silent
        return
    if not sys.stderr.isatty():
        lines = _Lines()
        yield lines.tell
        lines.end()
        return
    bar = Bar(BarColumn(24), TaskProgressColumn(), TimeRemainingColumn(), TextColumn("{task.description}"))
    task = bar.add_task("", total=1.0)
    curves = Curves()
    with Live(Group(bar, curves), console=Console(stderr=True), transient=True, refresh_per_second=8):

        def show(step: Step) -> None:
            curves.hear(step)
            bar.update(task, description=step.stage, completed=step.fraction)

        yield show


class Curves:
    """What the present stage makes smaller, drawn as it falls."""

    def __init__(self) -> None:
        self._stage = self._round = ""
        self._values: dict[str, list[float]] = {}

    def hear(self, step: Step) -> None:
        """Take in a step; a new stage begins a new picture."""
        if step.stage != self._stage:
            self._values = {}
        self._stage, self._round = step.stage, step.round
        for name, value in step.figures.items():
            self._values.setdefault(name, []).append(value)

    def __rich__(self) -> Text:
        """Return a line for each figure, in 80 columns."""
        lines = [
            f"{name[:NAME]:{NAME}} {values[-1]:<9.4g} {falling(values)}"
            for name, values in self._values.items()
        ]
        return Text("\n".join([self._round, *lines] if lines else []), no_wrap=True)


def falling(values: list[float]) -> str:
    """Return values as blocks, the highest for the largest, by their logarithms where all are positive."""
    told = [value for value in values if isfinite(value)]
    if not told:
        return ""
    heights = [log(value) for value in told] if min(told) > 0 else told
    few = [heights[round(place * (len(heights) - 1) / (WIDTH - 1))] for place in range(WIDTH)]
    shown = few if len(heights) > WIDTH else heights
    low, high = min(shown), max(shown)
    scale = (len(BLOCKS) - 1) / ((high - low) or 1.0)
    return "".join(BLOCKS[round((each - low) * scale)] for each in shown)


class _Lines:
    """A line for each stage as it begins, and one for where it ended if it made something smaller."""

    def __init__(self) -> None:
        self._last = Step("", 0.0)

    def tell(self, step: Step) -> None:
        if step.stage != self._last.stage:
            self.end()
            sys.stderr.write(f"{step.fraction:4.0%}  {step.stage}\n")
            sys.stderr.flush()
        self._last = step

    def end(self) -> None:
        if self._last.figures:
            told = ", ".join(f"{name} {value:.4g}" for name, value in self._last.figures.items())
            sys.stderr.write(f"      {self._last.round}: {told}\n")
            sys.stderr.flush()
