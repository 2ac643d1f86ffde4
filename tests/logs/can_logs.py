"""DBC files and CAN logs that tests make up."""

from pathlib import Path

import can
import cantools.database
from can.io.mf4 import MF4Writer

from hitchid.logs.content import ChannelSelection
from hitchid.logs.formats.can_decoder import Frame

EXTENDED = 0x80000000
MARKS = """BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
"""
PROTOCOL = """BA_DEF_ "ProtocolType" STRING ;
BA_DEF_DEF_ "ProtocolType" "";
BA_ "ProtocolType" "J1939";
"""


def message(identifier, name, *signals, length=8):
    """Return a message of a DBC; the id of one with 29 bits has the bit `EXTENDED`."""
    return "\n".join(
        [f"BO_ {identifier} {name}: {length} ECU", *(f" SG_ {signal}" for signal in signals), ""]
    )


def marked(*identifiers):
    """Return what marks messages of a DBC as J1939."""
    return MARKS + "".join(f'BA_ "VFrameFormat" BO_ {identifier} 3;\n' for identifier in identifiers)


def write_dbc(path, *messages, behind=""):
    """Write a DBC file and return its path."""
    text = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: ECU\n\n' + "\n".join(messages) + "\n" + behind
    Path(path).write_text(text)
    return Path(path)


def truth(path):
    """Return a DBC file as cantools has it."""
    return cantools.database.load_file(path, strict=False)


def frame(stamp_s, identifier, data, *, bus=1):
    """Return a frame as a reader hands it over."""
    return Frame(float(stamp_s), bus, identifier & ~EXTENDED, bool(identifier & EXTENDED), bytes(data))


def logged(frames, path):
    """Write frames as a log of the kind its name ends in, and return its path."""
    writer = {
        ".asc": can.ASCWriter,
        ".blf": can.BLFWriter,
        ".mf4": MF4Writer,
        ".trc": can.TRCWriter,
        ".log": can.CanutilsLogWriter,
    }[path.suffix]
    with writer(path) as log:
        for stamp_s, bus, identifier, extended, data in frames:
            log(
                can.Message(
                    timestamp=1.7e9 + stamp_s,
                    arbitration_id=identifier,
                    is_extended_id=extended,
                    data=data,
                    is_error_frame=data is None,
                    # python-can counts buses from 0; in some formats it stores one more.
                    channel=bus - 1 if path.suffix in (".asc", ".blf", ".trc") else bus,
                    is_fd=data is not None and len(data) > 8,
                )
            )
    return path


def wanted(*signals, databases=()):
    """Return a wish for signals, all of them where none is named."""
    return ChannelSelection("time_s", signals or None, tuple(databases))
