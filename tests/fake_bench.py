"""A bench in plain Python for tests of the bench loop: dead zones, gains, and a lag of the speed."""

import threading

import numpy as np

from hitchid.errors import InputError
from hitchid.hmi import Signal
from hitchid.hmi.disk import Disk
from hitchid.hmi.plans import Limits
from hitchid.hmi.source import Reading

STEP_S = 0.01
STROKE = 250.0  # mm
GAINS = (100.0, 80.0)  # mm/(s·A)
DEAD_ZONES = (0.35, 0.25)  # A
LIMITS = Limits(
    lifting_command=0.9, lowering_command=0.8, lowest_displacement=0.0, highest_displacement=STROKE
)
LIMITS_FILE = """\
lifting_command = 0.9
lowering_command = 0.8
lowest_displacement = 0.0
highest_displacement = 250.0
"""


class Plant:
    """A hitch between its stops; `sent` holds every command it was given.

    Args:
        displacement: at the start, mm.
        lag_s: time constant of its speed, s; zero for none.
        dead_zones: of lifting and lowering, A.
    """

    label = "plant"
    signals = (
        Signal("lifting_command", "Lifting command", "A", "command"),
        Signal("lowering_command", "Lowering command", "A", "command"),
        Signal("displacement", "Displacement", "mm", "displacement"),
    )
    step_s = STEP_S
    can_move = True

    def __init__(self, displacement=100.0, *, lag_s=0.0, dead_zones=DEAD_ZONES, virtual=True):
        self.displacement, self.lag_s, self.virtual = displacement, lag_s, virtual
        self.dead_zones = np.array(dead_zones)
        self.sent, self.speed, self.sample = [], 0.0, 0
        self.is_open = self.is_lost = self.is_silent = False

    def open(self):
        self.is_open = True

    def read(self):
        if self.is_lost:
            raise InputError("the plug was pulled")
        measured = np.nan if self.is_silent else self.displacement
        return (Reading(self.sample * STEP_S, (np.nan, np.nan, float(measured))),)

    def write(self, commands):
        self.sent.append(tuple(map(float, commands)))
        self.advance(commands)

    def advance(self, commands):
        up, down = np.array(GAINS) * np.maximum(np.asarray(commands) - self.dead_zones, 0.0)
        keep = np.exp(-STEP_S / self.lag_s) if self.lag_s else 0.0
        self.speed = keep * self.speed + (1 - keep) * (up - down)
        moved = self.displacement + STEP_S * self.speed
        self.displacement = float(np.clip(moved, 0.0, STROKE))
        self.sample += 1

    def close(self):
        self.is_open = False


class Machine(Plant):
    """The same as a real machine."""

    def __init__(self):
        super().__init__(virtual=False)


class DiskAtOnce(Disk):
    """A disk that has written whatever it is handed before the next line of a test."""

    def put(self, write):
        done = threading.Event()
        super().put(write)
        super().put(done.set)
        assert done.wait(60.0)


class Bench:
    """A bench loop with its source, and a clock that tests turn by hand."""

    def __init__(self, loop, plant):
        self.loop, self.plant, self.now_s = loop, plant, 0.0

    def ask(self, kind, **content):
        self.loop.handle({"type": kind, **content}, self.now_s)

    def tick(self, count=1, *, server=True, page=True):
        """Tick, with signs of life or without; return all samples."""
        readings = []
        for _ in range(count):
            self.now_s += STEP_S
            if server:
                self.loop.server_alive(self.now_s)
            if page:
                self.loop.page_alive(self.now_s)
            readings += self.loop.tick(self.now_s)
        return readings

    def run(self, **plan):
        """Arm and start a plan."""
        self.tick()
        self.ask("arm", plan=plan)
        self.ask("start")

    @property
    def state(self):
        return self.loop.state

    @property
    def reason(self):
        return self.loop.describe()["reason"]
