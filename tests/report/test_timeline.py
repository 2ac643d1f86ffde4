"""The picture of a mixed log: what is in it, and where it may be written."""

import numpy as np
import pytest

from hitchid.errors import OutputError
from hitchid.logs.kinds import segments
from hitchid.report.figures.timeline import draw, timeline

UP, DOWN = np.repeat([0, 1.0, 0, 0], 50), np.repeat([0, 0, 0, 1.0], 50)


@pytest.fixture
def drawn(make_record):
    """Return two records with their segments, the second with both valves on."""
    records = [
        make_record(np.cumsum(up - down), up, down, name=name)
        for name, up, down in (("calm", UP, DOWN), ("odd", UP, UP))
    ]
    return [(record, segments(record)) for record in records]


def test_the_legend_names_what_occurs_and_the_commands(drawn):
    calm, odd = drawn
    for records, kinds in (
        ([calm], ["lifting", "lowering", "hold"]),
        ([odd], ["hold", "both valves on"]),
        (drawn, ["lifting", "lowering", "hold", "both valves on"]),
    ):
        texts = [text.get_text() for text in timeline(records).legends[0].get_texts()]
        assert texts == [*kinds, "lifting command", "lowering command"]


def test_every_record_has_name_signals_and_axes_with_units(drawn):
    axes = timeline(drawn).axes
    assert len(axes) == 2 * len(drawn)
    for number, (record, found) in enumerate(drawn):
        above, below = axes[2 * number : 2 * number + 2]
        assert above.get_title(loc="left") == record.name
        assert above.get_ylabel() == "displacement / mm"
        assert (below.get_ylabel(), below.get_xlabel()) == ("command /\nA", "time / s")
        np.testing.assert_array_equal(above.lines[0].get_ydata(), record.displacement)
        assert len(above.patches) == len(found)
        for line, mode in zip(below.lines, record.directions, strict=True):
            np.testing.assert_array_equal(line.get_ydata(), record.command(mode))


@pytest.mark.parametrize(("ending", "begins"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_picture_has_its_names_format_and_needs_force(drawn, tmp_path, ending, begins):
    path = tmp_path / f"logs.{ending}"
    path.write_text("mine")
    with pytest.raises(OutputError, match="exists already"):
        draw(drawn, path)
    assert path.read_text() == "mine"
    draw(drawn, path, force=True)
    assert path.read_bytes().startswith(begins)
    assert list(tmp_path.iterdir()) == [path]
