"""The watchdog of a source that is moved: a process that sends zero when the bench loop falls silent.

It is forked from the bench loop when a plan is armed, and so has the open source: whether the loop was
killed, is frozen or hangs, zero is sent by somebody who is not. A loop that goes on is told, and stops.
"""

import contextlib
import os
import signal
import socket
import threading
import time
import warnings
from collections.abc import Callable

ALIVE, END = b".", b"e"  # to the watchdog: a sign of life, and its end
ACTED = b"0"  # its word that it has sent zero
ZERO_TRIES, ZERO_WAIT_S = 5, 0.02  # times that zero is sent after the loop was killed, s between; chosen
LONGEST_SEND_S = 1  # s that a source may take for a zero, then the watchdog ends as well; chosen


class Watchdog:
    """A process that watches this one.

    There `send_zero` is called after `longest_s` without a sign of life, and `tell` once this process has
    ended, with whether zero was sent.
    """

    def __init__(self, send_zero: Callable[[], None], longest_s: float, tell: Callable[[bool], None]) -> None:
        self._link, other = socket.socketpair()
        with warnings.catch_warnings():
            # Python and JAX warn that a lock may be held by a thread that the new process lacks. It calls
            # nothing but the source, and is ended where that does not return.
            warnings.simplefilter("ignore")
            self.process = os.fork()
        if self.process == 0:
            try:
                self._link.close()
                _watch(other, send_zero, longest_s, tell)
            finally:
                os._exit(0)
        other.close()
        self._link.setblocking(False)

    def alive(self) -> bool:
        """Give a sign of life; return False once the watchdog has sent zero, or has ended itself."""
        try:
            with contextlib.suppress(BlockingIOError):  # it does not read: what it says still counts
                self._link.send(ALIVE)
            self._link.recv(1)  # word that it has acted, or the end of it
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False

    def end(self) -> None:
        """End the watchdog: nothing is sent."""
        try:
            self._link.send(END)
        except BlockingIOError:
            # It does not read: once it does, it should not take this for a loop that is gone.
            os.kill(self.process, signal.SIGKILL)
        except OSError:  # it has ended
            pass
        self._link.close()
        # The system keeps a process until somebody has waited for it, which this one should not.
        threading.Thread(target=os.waitpid, args=(self.process, 0), daemon=True).start()


def _watch(
    link: socket.socket, send_zero: Callable[[], None], longest_s: float, tell: Callable[[bool], None]
) -> None:
    os.setsid()  # what ends the group of the bench loop should not end its watchdog
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    link.settimeout(longest_s)
    while True:
        try:
            said = link.recv(4096)
        except TimeoutError:
            _is_sent(send_zero)
            with contextlib.suppress(OSError):
                link.send(ACTED)
            continue
        except OSError:  # reset: killed before it had read what was said to it
            said = b""
        if END in said:
            return
        if not said:
            break
    sent = False
    for _ in range(ZERO_TRIES):
        sent = _is_sent(send_zero) or sent
        time.sleep(ZERO_WAIT_S)
    signal.alarm(LONGEST_SEND_S)
    with contextlib.suppress(OSError):
        tell(sent)


def _is_sent(send_zero: Callable[[], None]) -> bool:
    """Return whether zero was sent; a source that does not return is the end of this process."""
    signal.alarm(LONGEST_SEND_S)
    try:
        send_zero()
    except Exception:  # of a source from outside the package it may be any
        return False
    finally:
        signal.alarm(0)
    return True
