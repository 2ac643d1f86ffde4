"""From log files to a campaign; formats are registered in `formats`."""

from hitchid.data.content import Content as Content
from hitchid.data.content import LogChannel as LogChannel
from hitchid.readers.content import ChannelSelection as ChannelSelection
from hitchid.readers.content import match_channels as match_channels
from hitchid.readers.folders import find_logs as find_logs
from hitchid.readers.folders import settings_of as settings_of
from hitchid.readers.formats import Format as Format
from hitchid.readers.formats import format_of as format_of
from hitchid.readers.formats import write_table as write_table
from hitchid.readers.process import ReaderProcess as ReaderProcess
from hitchid.readers.reading import assemble as assemble
from hitchid.readers.reading import read as read
from hitchid.readers.reading import read_content as read_content
from hitchid.readers.reading import read_log as read_log
from hitchid.readers.reading import read_logs as read_logs
from hitchid.readers.reading import read_table as read_table
