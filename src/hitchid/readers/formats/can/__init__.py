"""CAN logs, with DBC files that say what is in their frames: `.asc` and `.blf` of Vector, MF4 of buses."""

import gzip
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hitchid.errors import LogError
from hitchid.readers.content import ChannelSelection, Content
from hitchid.readers.formats.can.blf import inventory
from hitchid.readers.formats.can.bus import read_bus as read_bus
from hitchid.readers.formats.can.mf4 import is_bus_log as is_bus_log
from hitchid.readers.formats.can.mf4 import read_mf4 as read_mf4
from hitchid.readers.formats.can.streams import Frame
from hitchid.readers.formats.extra import as_log_errors, import_optional

SUFFIXES = (".asc", ".asc.gz", ".blf")
KIND = "a CAN log"


def read(path: Path, selection: ChannelSelection) -> Content:
    """Read the wanted signals of a CAN log; `read_bus` says how they are named and met.

    Args:
        path: the log.
        selection: what is asked for, and the DBC files.

    Raises:
        LogError: the log or a DBC file cannot be read or is missing, a signal is not there, or python-can or
            cantools is missing.
    """
    library = import_optional("can", "can", path)
    notices: list[str] = []
    frames = (
        _read_blf(path, library, notices)
        if path.name.lower().endswith(".blf")
        else _read_asc(path, library, notices)
    )
    content = read_bus(frames, path, selection)
    return replace(content, notices=(*notices, *content.notices))


@dataclass
class _AscText:
    """What was seen of an ASC log so far: its lines, whether its end came, what is to be said."""

    line: int = 0
    begun: bool = False
    ended: bool = False
    notices: list[str] = field(default_factory=list)

    def lines(self, text: Iterable[str]) -> Iterator[str]:
        """Give the lines python-can is to see."""
        before_frames = True
        for self.line, line in enumerate(text, start=1):
            words = line.split(None, 4)
            if not words:
                continue
            is_event = words[0][0].isdigit()
            if is_event and not line.endswith("\n"):
                # Half a frame may still look like a whole one: the last digit of a byte may be missing.
                self.notices.append("the last line is left out: it does not end")
                return
            if is_event and before_frames:
                # python-can takes the first line that is not of the header for its end, and drops it.
                yield "\n"
            before_frames &= not is_event
            self.begun |= line.lower().lstrip().startswith("begin triggerblock")
            self.ended |= line.lower().lstrip().startswith("end triggerblock")
            # A request to send is no frame on the bus; that comes as Tx.
            if not (is_event and "TxRq" in words):
                yield line


def _read_asc(path: Path, library: Any, notices: list[str]) -> Iterator[Frame]:
    text = _AscText(notices=notices)
    try:
        # Any byte is a character of Latin-1; names and comments, where others stand, are not read.
        open_text = gzip.open if path.name.lower().endswith(".gz") else open
        with open_text(path, "rt", encoding="latin-1") as stream:
            reader = library.ASCReader(text.lines(stream))
            for message in reader:
                _check_absolute(path, reader)
                yield _to_frame(message)
    except (LogError, MemoryError):
        raise
    except Exception as error:  # python-can raises whatever a damaged line leads it to
        detail = str(error) or type(error).__name__
        raise LogError(path, f"cannot be read as {KIND}: {detail}", line=text.line or None) from error
    if text.begun and not text.ended:
        notices.append("the log has no 'End TriggerBlock': its end may be missing")


def _check_absolute(path: Path, reader: Any) -> None:
    if reader.timestamps_format == "relative":
        problem = "its time stamps count from the line before each; required 'base hex timestamps absolute'"
        raise LogError(path, problem)


def _read_blf(path: Path, library: Any, notices: list[str]) -> Iterator[Frame]:
    with as_log_errors(path, KIND):
        log_inventory = inventory(path)
        if not log_inventory.closed:
            notices.append("the log was never closed: its end may be missing")
        frame_count = 0
        with library.BLFReader(path) as reader:
            # Counted from 1970, stamps would be rounded to a quarter of a microsecond.
            reader.start_timestamp = 0.0
            for message in reader:
                frame_count += 1
                yield _to_frame(message)
        if frame_count != log_inventory.frame_count:
            raise LogError(
                path,
                f"cannot be read as {KIND}: {frame_count} of its {log_inventory.frame_count} frames can be read",
            )


def _to_frame(message: Any) -> Frame:
    data: bytes | None = None
    if not (message.is_error_frame or message.is_remote_frame):
        data = bytes(message.data)
        if len(data) < min(message.dlc, 64 if message.is_fd else 8):
            data = b""
    # python-can counts buses from 0, both formats from 1.
    bus = message.channel + 1 if isinstance(message.channel, int) else 0
    return Frame(message.timestamp, bus, message.arbitration_id, message.is_extended_id, data)
