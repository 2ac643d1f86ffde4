"""The bench loop's side of the planner: questions and answers, neither of which a tick waits for."""

import contextlib
import json
import os
import socket
import subprocess
import threading
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from hitchid._support.processes import Outbox, connected_module
from hitchid.errors import InputError
from hitchid.hmi.disk import Disk
from hitchid.hmi.plans import AdaptivePlan
from hitchid.hmi.programs import Machine

LONGEST_END_S = 1.0  # s that the planner may take to end; then it is killed; chosen
PLANNER_NICE = 5  # lower priority than the bench loop


class PlannerLink:
    """The planner of a campaign as a process beside the bench loop; see `hitchid.hmi.planner`.

    Attributes:
        why: the last choice and its reason, in one line.
        minutes: bench time that was spent until then.
        result: what the campaign ended with; empty before.
    """

    def __init__(self, root: Path, folder: str, plan: AdaptivePlan, machine: Machine, disk: Disk) -> None:
        self.why, self.minutes = "", 0.0
        self.result: Mapping[str, Any] = {}
        self._disk, self._error = disk, ""
        self._answer: dict[str, Any] | None = None
        self._answered, self._is_asked = threading.Event(), False
        settings = {
            "root": str(root),
            "folder": folder,
            "plan": plan.model_dump(),
            "limits": machine.limits.model_dump(),
            "interval_s": machine.interval_s,
            "is_virtual": machine.is_virtual,
        }
        self._process, self._connection = connected_module(
            "hitchid.hmi.planner", json.dumps(settings), new_session=True
        )
        with contextlib.suppress(OSError, AttributeError):  # AttributeError: not on macOS
            # It inherits that the bench loop goes before all others, which it must not.
            os.sched_setscheduler(self._process.pid, os.SCHED_OTHER, os.sched_param(0))
            os.setpriority(os.PRIO_PROCESS, self._process.pid, PLANNER_NICE)
        self._outbox = Outbox(self._connection)
        threading.Thread(target=self._receive, daemon=True).start()

    def ask(self, state: Mapping[str, Any]) -> None:
        """Ask for the next test, behind the logs that the disk was handed before."""
        self.minutes = float(state["minutes"])
        self._answered.clear()
        self._answer, self._is_asked = None, True
        self._disk.put(partial(self._outbox.put, json.dumps(state).encode()))

    def answer(self) -> Mapping[str, Any] | None:
        """Return the answer to the last question; None while there is none.

        Raises:
            InputError: the planner failed or has ended.
        """
        if self._error:
            raise InputError(self._error)
        return self._answer

    def wait(self, longest_s: float) -> None:
        """Wait for an answer where one is due, for a machine that stands still meanwhile."""
        if self._is_asked:
            self._answered.wait(longest_s)

    def end(self) -> None:
        """End the process, in a thread of its own: a tick does not wait for it."""
        threading.Thread(target=self._end, daemon=True).start()

    def _end(self) -> None:
        with contextlib.suppress(OSError):
            # The watchdog may have a copy of it: closing alone would not end the process.
            socket.socket(fileno=os.dup(self._connection.fileno())).shutdown(socket.SHUT_RDWR)
        try:
            self._process.wait(LONGEST_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _receive(self) -> None:
        try:
            while True:
                content = json.loads(self._connection.recv_bytes())
                self._error = str(content.get("error", ""))
                if not self._error:
                    self.why = str(content["why"])
                    self.result = content["result"] or self.result
                    self._answer = content
                self._is_asked = False
                self._answered.set()
        except (EOFError, OSError, TypeError):  # TypeError: closed by this side in the middle of a message
            self._error = self._error or "the planner of the campaign has ended; go on with --resume"
            self._answered.set()
