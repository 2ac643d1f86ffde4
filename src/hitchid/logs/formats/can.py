"""CAN logs, decoded by DBC files: of Vector (`.asc`, `.blf`), PEAK (`.trc`), candump, MF4 with bus frames."""

import gzip
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hitchid.errors import LogError
from hitchid.logs.content import ChannelSelection, Content
from hitchid.logs.formats.can_bus import read_bus as read_bus
from hitchid.logs.formats.can_mf4 import is_bus_log as is_bus_log
from hitchid.logs.formats.can_mf4 import read_mf4 as read_mf4
from hitchid.logs.formats.can_streams import Frame, candump_frames, inventory
from hitchid.logs.formats.can_streams import is_candump as is_candump
from hitchid.logs.formats.library import as_log_errors, import_optional

SUFFIXES = (".asc", ".asc.gz", ".blf", ".trc")
CANDUMP_SUFFIXES = (".log",)
KIND = "a CAN log"


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the selected signals of a CAN log; `read_bus` describes their names.

    Args:
        path: the log.
        selection: the requested signals, and the DBC files.

    Raises:
        LogError: the log or a DBC file is missing or unreadable, a signal is missing, or python-can or
            cantools is not installed.
    """
    library = import_optional("can", "can", path)
    notices: list[str] = []
    readers = {".blf": _read_blf, ".trc": _read_trc, ".log": _read_candump}
    frames = readers.get(path.suffix.lower(), _read_asc)(path, library, notices)
    content = read_bus(frames, path, selection)
    return replace(content, notices=(*notices, *content.notices))


@dataclass
class _AscText:
    """State while an ASC log is read: line number, block markers seen, notices."""

    line: int = 0
    begun: bool = False
    ended: bool = False
    notices: list[str] = field(default_factory=list)

    def lines(self, text: Iterable[str]) -> Iterator[str]:
        """Yield the lines for python-can."""
        before_frames = True
        for self.line, line in enumerate(text, start=1):
            words = line.split(None, 4)
            if not words:
                continue
            is_event = words[0][0].isdigit()
            if is_event and not line.endswith("\n"):
                # A cut frame may look complete: the last digit of a byte may be missing.
                self.notices.append("the last line is left out: it is incomplete")
                return
            if is_event and before_frames:
                # python-can drops the first line after the header.
                yield "\n"
            before_frames &= not is_event
            self.begun |= line.lower().lstrip().startswith("begin triggerblock")
            self.ended |= line.lower().lstrip().startswith("end triggerblock")
            # A send request is not a frame on the bus; the frame follows as Tx.
            if not (is_event and "TxRq" in words):
                yield line


def _read_asc(path: Path, library: Any, notices: list[str]) -> Iterator[Frame]:
    text = _AscText(notices=notices)
    try:
        # Latin-1 decodes any byte; names and comments, which may hold others, are not used.
        open_text = gzip.open if path.name.lower().endswith(".gz") else open
        with open_text(path, "rt", encoding="latin-1") as stream:
            reader = library.ASCReader(text.lines(stream))
            for message in reader:
                _check_absolute(path, reader)
                yield _to_frame(message)
    except (LogError, MemoryError):
        raise
    except Exception as error:  # python-can may raise anything on a damaged line
        detail = str(error) or type(error).__name__
        raise LogError(path, f"cannot be read as {KIND}: {detail}", line=text.line or None) from error
    if text.begun and not text.ended:
        notices.append("the log has no 'End TriggerBlock': it may be incomplete")


def _check_absolute(path: Path, reader: Any) -> None:
    if reader.timestamps_format == "relative":
        problem = "its time stamps are relative to the previous line; expected 'base hex timestamps absolute'"
        raise LogError(path, problem)


def _read_candump(path: Path, _: Any, notices: list[str]) -> Iterator[Frame]:
    with as_log_errors(path, KIND), path.open(encoding="latin-1") as stream:
        yield from candump_frames(stream, notices)


def _read_trc(path: Path, library: Any, notices: list[str]) -> Iterator[Frame]:
    text = _AscText(notices=notices)
    try:
        with path.open(encoding="latin-1") as stream:
            for message in library.TRCReader(text.lines(stream)):
                # python-can and PEAK count buses from 1.
                yield _to_frame(message)._replace(bus=message.channel if message.channel else 0)
    except (LogError, MemoryError):
        raise
    except Exception as error:  # python-can may raise anything on a damaged line
        detail = str(error) or type(error).__name__
        raise LogError(path, f"cannot be read as {KIND}: {detail}", line=text.line or None) from error


def _read_blf(path: Path, library: Any, notices: list[str]) -> Iterator[Frame]:
    with as_log_errors(path, KIND):
        log_inventory = inventory(path)
        if not log_inventory.closed:
            notices.append("the log was never closed: it may be incomplete")
        frame_count = 0
        with library.BLFReader(path) as reader:
            # From 1970, the stamps would be rounded to 0.25 µs.
            reader.start_timestamp = 0.0
            for message in reader:
                frame_count += 1
                yield _to_frame(message)
        if frame_count != log_inventory.frame_count:
            problem = f"{frame_count} of its {log_inventory.frame_count} frames can be read"
            raise LogError(path, f"cannot be read as {KIND}: {problem}")


def _to_frame(message: Any) -> Frame:
    data: bytes | None = None
    if not (message.is_error_frame or message.is_remote_frame):
        data = bytes(message.data)
        if len(data) < min(message.dlc, 64 if message.is_fd else 8):
            data = b""
    # python-can counts buses from 0, both formats from 1.
    bus = message.channel + 1 if isinstance(message.channel, int) else 0
    return Frame(message.timestamp, bus, message.arbitration_id, message.is_extended_id, data)
