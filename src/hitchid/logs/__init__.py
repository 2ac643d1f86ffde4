"""Records on a uniform clock, campaigns of tests, units, kinds of test, segmentation of mixed logs."""

from hitchid.logs.content import ChannelSelection as ChannelSelection
from hitchid.logs.content import Content as Content
from hitchid.logs.content import LogChannel as LogChannel
from hitchid.logs.content import match_channels as match_channels
from hitchid.logs.formats import Format as Format
from hitchid.logs.formats import format_of as format_of
from hitchid.logs.formats import write_table as write_table
from hitchid.logs.inspect import InspectedRecord as InspectedRecord
from hitchid.logs.inspect import Inspection as Inspection
from hitchid.logs.inspect import inspect as inspect
from hitchid.logs.inspect import inspect_campaign as inspect_campaign
from hitchid.logs.propose import propose as propose
from hitchid.logs.reader_process import ReaderProcess as ReaderProcess
from hitchid.logs.reading import assemble as assemble
from hitchid.logs.reading import find_logs as find_logs
from hitchid.logs.reading import read as read
from hitchid.logs.reading import read_content as read_content
from hitchid.logs.reading import read_log as read_log
from hitchid.logs.reading import read_logs as read_logs
from hitchid.logs.reading import read_table as read_table
from hitchid.logs.reading import settings_of as settings_of
