"""Long work tells where it stands: as part of a whole, and what a terminal makes of it."""

import json
import math
import sys
from io import StringIO
from types import ModuleType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid._support.progress import (
    ProgressUpdate,
    iteration_progress,
    parallel_progress,
    split_progress,
    subtask_progress,
)
from hitchid._support.progress_display import BLOCKS, WIDTH, Curves, progress, shown, sparkline

fractions = st.floats(0, 1)


def test_parts_of_parts_are_named_from_the_outside_in():
    updates = []
    inner = subtask_progress(subtask_progress(updates.append, 0.5, 0.5, "lifting"), 0.2, 0.4)
    inner(ProgressUpdate("phase 1", 0.5, "iteration 3", {"RMSE": 1.0}))
    fraction = 0.5 + 0.5 * (0.2 + 0.4 * 0.5)
    assert updates == [ProgressUpdate("lifting: phase 1", fraction, "iteration 3", {"RMSE": 1.0})]


@given(st.lists(st.tuples(st.sampled_from(["lifting", "lowering"]), fractions), min_size=1))
def test_simultaneous_works_add_up_to_the_whole(updates):
    whole = []
    tell = parallel_progress(whole.append, ["lifting", "lowering"])
    last = {"lifting": 0.0, "lowering": 0.0}
    for name, fraction in updates:
        tell[name](ProgressUpdate("phase 1", fraction))
        last[name] = max(last[name], fraction)
        expected = pytest.approx((last["lifting"] + last["lowering"]) / 2)
        assert whole[-1] == ProgressUpdate(f"{name}: phase 1", expected, task=name)


@given(st.lists(st.floats(0.01, 10), min_size=1, max_size=6), st.data())
def test_parts_follow_each_other_from_beginning_to_end(shares, data):
    updates = []
    parts = split_progress(updates.append, {str(number): share for number, share in enumerate(shares)})
    for number in range(len(shares)):
        for done in (0.0, data.draw(fractions), 1.0):
            parts[str(number)](ProgressUpdate("stage", done))
            before = sum(shares[:number])
            assert updates[-1].fraction == pytest.approx((before + done * shares[number]) / sum(shares))


def test_rounds_go_on_without_reaching_the_end():
    updates = []
    hear = iteration_progress(updates.append, "search", "RMSE / mm")
    for number in range(1, 2000, 37):
        hear(number, 1.0 / number)
    done = [step.fraction for step in updates]
    assert done == sorted(done)
    assert done[0] > 0
    assert done[-1] < 1
    assert updates[1].iteration == "iteration 38"
    assert updates[1].figures == {"RMSE / mm": 1.0 / 38}


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=200))
def test_a_curve_fits_its_place_whatever_the_figures(values):
    drawn = sparkline(values)
    assert len(drawn) <= WIDTH
    assert set(drawn) <= set(BLOCKS)
    assert bool(drawn) == any(map(math.isfinite, values))


def test_a_falling_figure_is_drawn_falling():
    drawn = sparkline([10.0 * 0.8**k for k in range(100)])
    heights = [BLOCKS.index(block) for block in drawn]
    assert (heights[0], heights[-1]) == (len(BLOCKS) - 1, 0)
    assert heights == sorted(heights, reverse=True)


def test_figures_of_a_stage_fit_80_columns_and_go():
    curves = Curves()
    for number in range(50):
        figures = {"RMSE on levels held out / mm": 1.0 / (1 + number), "another": 2.0}
        curves.update(ProgressUpdate("lifting: phase 1", 0.1, f"iteration {number}", figures))
    shown = curves.__rich__().plain.splitlines()
    assert shown[0] == "iteration 49"
    assert "0.02" in shown[1]
    assert max(map(len, shown)) <= 80
    curves.update(ProgressUpdate("lifting: phase 2", 0.5))
    assert curves.__rich__().plain == ""


def test_works_at_the_same_time_have_each_its_curves():
    curves = Curves()
    for number in range(20):
        for name in ("lifting", "lowering"):
            step = ProgressUpdate(f"{name}: phase 1", 0.1, f"iteration {number}", {"RMSE / mm": 1.0}, name)
            curves.update(step)
    assert curves.stages == "lifting: phase 1 | lowering: phase 1"
    shown = curves.__rich__().plain.splitlines()
    assert [line.split()[:2] for line in shown[::2]] == [["lifting", "iteration"], ["lowering", "iteration"]]
    assert len(shown) == 4
    curves.update(ProgressUpdate("validation", 0.9))
    assert curves.stages == "validation"
    assert curves.__rich__().plain == ""


def test_in_a_file_a_stage_has_two_lines(capsys):
    with progress() as report:
        for number in range(2):
            for name in ("lifting", "lowering"):
                figures = {"RMSE / mm": 3.0 - number}
                report(ProgressUpdate(f"{name}: search", 0.1, f"iteration {number}", figures, name))
        report(ProgressUpdate("lifting: training", 0.5, task="lifting"))
        report(ProgressUpdate("validation", 0.9, "iteration 7", {"RMSE / mm": 1.0}))
        report(ProgressUpdate("end", 1.0))
    assert capsys.readouterr().err.splitlines() == [
        " 10%  lifting: search",
        " 10%  lowering: search",
        "      lifting, iteration 1: RMSE / mm 2",
        " 50%  lifting: training",
        "      lowering, iteration 1: RMSE / mm 2",
        " 90%  validation",
        "      iteration 7: RMSE / mm 1",
        "100%  end",
    ]


def test_what_has_been_reached_is_a_line_of_its_own(capsys, monkeypatch):
    update = ProgressUpdate("physics model", 0.5, message="physics model saved")
    with progress() as report:
        report(update)
    assert capsys.readouterr().err == "physics model saved\n"
    monkeypatch.setenv("HITCHID_PROGRESS", "json")
    with progress() as report:
        report(ProgressUpdate("physics model", 0.5))
        report(update)
    first, second = (json.loads(line)["progress"] for line in capsys.readouterr().err.splitlines())
    assert (first["message"], second["message"]) == ("", "physics model saved")


class Display:
    """A cell's output as a notebook shows it."""

    def __init__(self):
        self.contents = []

    def update(self, content):
        self.contents.append(content)


def test_in_a_notebook_a_bar_is_replaced_and_messages_stay(monkeypatch):
    handle, module = Display(), ModuleType("IPython.display")
    module.HTML, module.display = str, lambda content, display_id: handle
    monkeypatch.setitem(sys.modules, "ipykernel", ModuleType("ipykernel"))
    monkeypatch.setitem(sys.modules, "IPython", ModuleType("IPython"))
    monkeypatch.setitem(sys.modules, "IPython.display", module)
    with shown(True) as report:
        report(ProgressUpdate("a < b", 0.2, message="saved <b>"))
        report(ProgressUpdate("end", 1.0))
    assert "a &lt; b" in handle.contents[0]
    assert 'value="1.000"' in handle.contents[-1]
    assert all("saved &lt;b&gt;" in content for content in handle.contents)


def test_in_a_script_only_a_function_gets_updates(capsys):
    updates = []
    for display in (shown(True), shown(False), shown(None), shown(updates.append), progress(quiet=True)):
        with display as report:
            report(ProgressUpdate("search", 0.1))
    assert capsys.readouterr() == ("", "")
    assert updates == [ProgressUpdate("search", 0.1)]


@pytest.mark.parametrize("height", [24, 5])
def test_on_a_terminal_figures_are_drawn_and_taken_away(monkeypatch, height):
    """On a terminal of any height; what is left on it at the end is nothing."""
    screen = StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", str(height))
    with progress() as report:
        report(ProgressUpdate("lifting: phase 1", 0.25, "iteration 5", {"RMSE / mm": 0.5}))
    assert "lifting: phase 1" in screen.getvalue()
    assert "RMSE / mm" in screen.getvalue()
    assert "\x1b[2K" in screen.getvalue()
