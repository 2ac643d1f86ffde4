"""From files to a campaign: `read` finds the logs, their signal map and their format."""

from hitchid.readers.csv import write_table as write_table
from hitchid.readers.reading import Format as Format
from hitchid.readers.reading import assemble as assemble
from hitchid.readers.reading import find_logs as find_logs
from hitchid.readers.reading import format_of as format_of
from hitchid.readers.reading import read as read
from hitchid.readers.reading import read_log as read_log
from hitchid.readers.reading import settings_of as settings_of
