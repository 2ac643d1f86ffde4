"""A machine in closed form: in both directions an integrator behind a dead zone, as `handmade.hitch` models.

Of nothing but numpy; its gains and dead zones may differ from the model's, which is what adaptation is for.
"""

from dataclasses import replace

import numpy as np

import handmade
from handmade import DEAD_ZONES, GAINS, STEP_S
from hitchid.live import Stroke
from hitchid.logs.record import LIFTING, LOWERING

FILTER = handmade.LOAD_FILTERS[LIFTING]
COVERED = handmade.envelope(displacement=(40.0, 160.0))


def model(**options):
    """Return a model by hand that both directions of a machine follow alike, their speeds within 2 %."""
    hitch = handmade.hitch(covered=COVERED, filtered=True, **options)
    return replace(
        hitch, channels={mode: replace(own, load_filter=FILTER) for mode, own in hitch.channels.items()}
    )


MODEL = model()
LARGEST = handmade.COVERED["command"][1]  # A beyond the dead zone
NOISE = float(FILTER.noise)
REST, SETTLED = 50, 30  # samples before a command, and after it until a stroke ends: 0.3 s
DIRECTIONS = (LIFTING, LOWERING)


def moved(start, commands, gain=1.0, dead_zone=0.0):
    """Return the displacement under commands, mm: of a machine with factors on gains, and A on dead zones."""
    speed = np.zeros(len(commands))
    for column, (mode, sign) in enumerate(handmade.DIRECTIONS.items()):
        beyond = np.maximum(commands[:, column] - DEAD_ZONES[mode] - dead_zone, 0.0)
        speed += sign * gain * GAINS[mode] * beyond
    return start + STEP_S * np.concatenate([[0.0], np.cumsum(speed)[:-1]])


def command(mode, levels, samples=100, rest=REST, settled=SETTLED):
    """Return rest, some levels beyond the identified dead zone of so many samples each, and rest, [N, 2]."""
    active = np.repeat(DEAD_ZONES[mode] + np.asarray(levels), samples)
    commands = np.zeros((rest + active.size + settled, 2))
    commands[rest : rest + active.size, DIRECTIONS.index(mode)] = active
    return commands


def stroke(mode=LIFTING, levels=(0.2, 0.4), *, start=100.0, seed=None, begin=REST, samples=100, **machine):
    """Return a stroke of a machine; without a seed it is measured without noise."""
    commands = command(mode, levels, samples)
    displacement = moved(start, commands, **machine)
    if seed is not None:
        displacement += NOISE * np.random.default_rng(seed).standard_normal(displacement.size)
    return Stroke(mode, begin, REST, commands, displacement)


def strokes(count, *, seed=0, scatter=0.0, changed_at=0, first=0, start=100.0, samples=100, **changed):
    """Return strokes up and down, in turn, each at two levels of its own, without a pause between them.

    Args:
        count: number of strokes.
        seed: of levels, noise and scatter.
        scatter: of the gain from stroke to stroke, relative.
        changed_at: number of the first stroke of the machine as `changed` says; before it is as the model.
        first: number of the first stroke, which tells its place in the log.
        start: displacement before it, mm.
        samples: of each level.
        changed: factor on the gains, and A on the dead zones.
    """
    rng = np.random.default_rng(seed)
    made, at = [], start
    for number in range(count):
        levels = rng.uniform([0.1, 0.3], [0.2, 0.45])
        now = changed if number >= changed_at else {}
        gain = now.get("gain", 1.0) * np.exp(scatter * rng.standard_normal())
        mode = DIRECTIONS[number % 2]
        own = stroke(mode, levels, start=at, samples=samples, **{**now, "gain": gain})
        at = float(own.displacement[-1])
        noisy = own.displacement + NOISE * rng.standard_normal(own.displacement.size)
        begin = REST + (first + number) * len(noisy)
        made.append(own._replace(begin=begin, displacement=noisy))
    return made


def stream(strokes):
    """Return commands and displacement of strokes one after the other, shapes [N, 2] and [N]."""
    return (
        np.concatenate([stroke.commands for stroke in strokes]),
        np.concatenate([stroke.displacement for stroke in strokes]),
    )
