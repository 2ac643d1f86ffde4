"""A source that the operator chose, checked and opened, with its limits."""

import contextlib
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hitchid._support import checks
from hitchid.bench.parameter_files import load_rig, parameter_sets
from hitchid.errors import InputError
from hitchid.hmi import project
from hitchid.hmi.plans import Limits, limits_of_rig, read_limits
from hitchid.hmi.source import CLOSED, REQUIRED, Reading, Source
from hitchid.hmi.sources import make_source
from hitchid.hmi.sources.json_lines import JsonLines

FASTEST = 20  # samples of a virtual source in a tick at most; chosen: more than two cores reach
# s, sampling times: the largest of a source that is moved bounds the delay of a stop; chosen.
SHORTEST_STEP_S, LONGEST_STEP_S, LONGEST_MOVED_STEP_S = 0.001, 10.0, 0.1
ZERO_TRIES, ZERO_WAIT_S = 5, 0.01  # times that zero is sent to a source that fails, s between them; chosen


@dataclass(frozen=True)
class ConnectedSource:
    """A source that is open.

    Attributes:
        source: that is read and written to.
        name: that the operator chose.
        speed: samples in a tick of a run; above 1 of a virtual source only.
        limits: of commands and travel; None where nothing may be moved.
        takes_output: whether anything is written to it.
    """

    source: Source
    name: str
    speed: int
    limits: Limits | None
    takes_output: bool

    @property
    def is_watched(self) -> bool:
        """Whether something may go on moving when this process does not; the package's own end with it."""
        return self.takes_output and self.source.can_move and self.name not in ("rig", "replay")

    def read(self) -> list[Reading]:
        """Return the samples that have arrived, as numbers.

        Raises:
            InputError: a sample has not a number for each signal.
        """
        readings = []
        # A source of the operator's own may return anything; what follows needs numbers, as many as signals.
        for time_s, values in self.source.read():
            if len(values) != len(self.source.signals):
                raise InputError(f"{self.source.label}: expected a value for each signal in a sample")
            readings.append(Reading(float(time_s), tuple(map(float, values))))
        return readings

    def write(self, commands: np.ndarray) -> None:
        """Send commands; to a machine only where that is allowed, zero as well."""
        if self.takes_output:
            self.source.write(commands)

    def close(self) -> bool:
        """Send zero, several times where that fails, and disconnect; return whether zero was sent."""
        sent = False
        for _ in range(ZERO_TRIES):
            with contextlib.suppress(Exception):  # it may be gone, or busy for a moment
                self.write(CLOSED)
                sent = True
                break
            time.sleep(ZERO_WAIT_S)
        with contextlib.suppress(Exception):
            self.source.close()
        return sent


def connect(
    request: Mapping[str, Any],
    root: Path,
    *,
    limits: Path | Limits | None,
    allow_output: bool,
    make: Callable[[str], Source] = make_source,
) -> ConnectedSource:
    """Return the source of a request, open; a virtual bench has its own limits, not those of the file.

    JSON lines carry no units: theirs are those of the limits.

    Raises:
        InputError: there is no such source, or it, its options or its limits cannot be used.
    """
    name, options = str(request.get("source")), request.get("options", {})
    checks.instance(options, dict, "options", "a table")
    text = name
    if name == "rig":
        text = f"rig:{checks.one_of(options.get('rig', 'nominal'), parameter_sets(), 'rig')}"
    elif name == "replay":
        text = f"replay:{project.file_inside(root, options.get('log'))}"
    source = make(text)
    # Checked before it is opened: a source that cannot be used should not be touched.
    names = tuple(signal.name for signal in source.signals)
    if names[: len(REQUIRED)] != REQUIRED:
        raise InputError(f"{source.label}: expected the signals {', '.join(REQUIRED)} first, got {names}")
    longest_s = LONGEST_MOVED_STEP_S if source.can_move else LONGEST_STEP_S
    if not SHORTEST_STEP_S <= source.step_s <= longest_s:
        raise InputError(
            f"{source.label}: expected a sampling time of {SHORTEST_STEP_S:g} to {longest_s:g} s, "
            f"got {source.step_s:g} s"
        )
    # A machine has the speed it has: faster than time is for what stands still between two samples.
    speed = checks.integer(options.get("speed", 1), "speed", minimum=1)
    fastest = FASTEST if source.virtual else 1
    if speed > fastest:
        raise InputError(f"speed: expected at most {fastest} here, got {speed}")
    if text.startswith("rig:"):
        limits = limits_of_rig(load_rig(text.removeprefix("rig:")))
    else:
        limits = read_limits(limits) if isinstance(limits, Path) else limits
    # Numbers without a conversion between: 0.9 in mA would be another limit than 0.9 in A.
    units = () if limits is None else (limits.command_unit, limits.command_unit, limits.displacement_unit)
    if isinstance(source, JsonLines):
        source.use_units(units)
    for signal, unit in zip(source.signals, units, strict=False):
        if signal.unit != unit:
            raise InputError(f"limits: {signal.name} is in {unit}, in {source.label} in {signal.unit}")
    source.open()
    return ConnectedSource(source, name, speed, limits, source.virtual or allow_output)
