"""Levels of the command of strokes: the median beyond the dead zone, and whether several differ."""

import numpy as np
import pytest

import machine
from hitchid.live.channel_state import level, levels_differ
from hitchid.logs.record import LIFTING, LOWERING
from machine import MODEL


@pytest.mark.parametrize("mode", [LIFTING, LOWERING])
@pytest.mark.parametrize(("levels", "median"), [((0.3,), 0.3), ((0.1, 0.4, 0.4), 0.4)])
def test_the_level_of_a_stroke_is_the_median_beyond_the_dead_zone(mode, levels, median):
    found = level(MODEL.channels[mode], machine.stroke(mode, levels))
    assert found == pytest.approx(median, rel=1e-12)


def test_a_stroke_without_a_command_has_no_level():
    channel, stroke = MODEL.channels[LIFTING], machine.stroke(LIFTING)
    still = stroke._replace(commands=np.zeros_like(stroke.commands))
    assert level(channel, still) == 0.0
    assert not levels_differ(channel, [still])


@pytest.mark.parametrize(("first", "second", "differ"), [(0.3, 0.35, False), (0.3, 0.37, True)])
def test_levels_differ_by_a_factor(first, second, differ):
    strokes = [machine.stroke(LIFTING, (each,)) for each in (first, second)]
    assert levels_differ(MODEL.channels[LIFTING], strokes) is differ
    assert levels_differ(MODEL.channels[LIFTING], [machine.stroke(LIFTING, (first, second))]) is differ
