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

from hitchid._support.progress import Progress, Step, silent

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
            bar.update(task, description=curves.stages, completed=step.fraction)

        yield show


class Curves:
    """What the present stage of each strand makes smaller, drawn as it falls."""

    def __init__(self) -> None:
        self._strands: dict[str, tuple[Step, dict[str, list[float]]]] = {}

    def hear(self, step: Step) -> None:
        """Take in a step; a new stage begins a new picture, and work on the whole ends the strands."""
        together = {name: each for name, each in self._strands.items() if bool(name) == bool(step.strand)}
        last, values = together.get(step.strand, (step, {}))
        values = values if last.stage == step.stage else {}
        for name, value in step.figures.items():
            values.setdefault(name, []).append(value)
        self._strands = {**together, step.strand: (step, values)}

    @property
    def stages(self) -> str:
        """The stages that are being done."""
        return " | ".join(step.stage for step, _ in self._strands.values())

    def __rich__(self) -> Text:
        """Return the round of each strand and a line for each figure, in 80 columns."""
        lines = []
        for step, values in self._strands.values():
            told = [
                f"{name[:NAME]:{NAME}} {series[-1]:<9.4g} {falling(series)}"
                for name, series in values.items()
            ]
            lines += [" ".join(filter(None, (step.strand, step.round))), *told] if told else []
        return Text("\n".join(lines), no_wrap=True)


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
        self._last: dict[str, Step] = {}

    def tell(self, step: Step) -> None:
        last = self._last.get(step.strand)
        if last is None or step.stage != last.stage:
            self.end(*filter(None, [step.strand]))
            sys.stderr.write(f"{step.fraction:4.0%}  {step.stage}\n")
            sys.stderr.flush()
        self._last[step.strand] = step

    def end(self, *strands: str) -> None:
        """Say where the last stages of strands ended; those of all where none is named."""
        for strand in strands or tuple(self._last):
            last = self._last.pop(strand, None)
            if last is not None and last.figures:
                told = ", ".join(f"{name} {value:.4g}" for name, value in last.figures.items())
                stage = f"{strand}, " if strand else ""
                sys.stderr.write(f"      {stage}{last.round}: {told}\n")
                sys.stderr.flush()
