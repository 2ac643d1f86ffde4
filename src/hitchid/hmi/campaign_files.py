"""Files of a campaign that chooses its own tests: its logs, what is never fitted, and how far it has come."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hitchid._support.files import write_file
from hitchid.errors import InputError
from hitchid.hmi import project
from hitchid.hmi.adaptive import Start

PROGRESS = "progress.json"  # what a campaign knows beside its logs
VALIDATION = "validation-"  # begins the names of tests that are never fitted
MOVES = "moves/move"  # begins those of the moves between tests
SETTINGS = "identify.toml"  # of an identification of few tests
# Tests of a direction, below which those that are held out in turn are too few to choose its form: of five,
# the choice ends with the smallest, up to four times as wrong as an axis with dry friction (measured).
FEW_TESTS = 8
FORM = """structure = "integrator-second-order-stroke"
dead_time = true
curve = true
spool = true
position = true
"""


def read_progress(folder: Path) -> dict[str, Any]:
    """Return what a campaign knew when it was stopped; empty where it knew nothing yet.

    Raises:
        InputError: there is no such campaign, or the file is none that a campaign wrote.
    """
    if not folder.is_dir():
        raise InputError(f"{folder.name}: there is no such campaign to resume")
    path = folder / PROGRESS
    if not path.exists():
        return {}
    try:
        content = json.loads(path.read_bytes())
        start = asdict(Start.of(content["start"]))
        minutes, rounds = float(content["minutes"]), [dict(entry) for entry in content["rounds"]]
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(f"{path.name}: is not what a campaign wrote; delete it to start anew") from error
    return {"start": start, "minutes": minutes, "rounds": rounds}


class CampaignFiles:
    """The folder of a campaign; names of logs are relative to it, without suffix."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def logs(self) -> list[str]:
        """Return the names of all logs, those of the careful start and of the moves included."""
        logs = [*self.folder.glob("*.csv"), *self.folder.glob("*/*.csv")]
        return sorted(str(log.relative_to(self.folder).with_suffix("")) for log in logs)

    def count(self, prefix: str) -> int:
        """Return how many logs have names that begin so."""
        return sum(name.startswith(prefix) for name in self.logs())

    def fresh(self, prefix: str) -> str:
        """Return a name that no log has, also where some were deleted."""
        taken, number = set(self.logs()), 1
        while f"{prefix}-{number:02d}" in taken:
            number += 1
        return f"{prefix}-{number:02d}"

    def hold_out_validations(self) -> None:
        """Say in `campaign.toml` that validation tests are never fitted, once there is one."""
        path = self.folder / project.CAMPAIGN_FILE
        content = path.read_text(encoding="utf-8")
        # Not before: a pattern that matches no test is refused where the logs are read.
        if "[split]" not in content and self.count(VALIDATION):
            _replace(path, f'{content}\n[split]\ntest = ["{VALIDATION}*"]\n'.encode())

    def settle_form(self, directions: Sequence[str]) -> None:
        """Write settings of `identify` that give the form, while there are too few tests to choose it."""
        path = self.folder / SETTINGS
        if min(self.count(f"{direction}-") for direction in directions) < FEW_TESTS:
            _replace(path, "\n".join(f"[{direction}]\n{FORM}" for direction in directions).encode())
        else:
            path.unlink(missing_ok=True)

    def save(self, minutes: float, start: Start, rounds: Sequence[Mapping[str, Any]]) -> None:
        """Write how far the campaign has come, whole or not at all."""
        content = {"minutes": minutes, "start": asdict(start), "rounds": list(rounds)}
        _replace(self.folder / PROGRESS, json.dumps(content, indent=1).encode())


def _replace(path: Path, content: bytes) -> None:
    write_file(path, lambda temporary: temporary.write_bytes(content), force=True)
