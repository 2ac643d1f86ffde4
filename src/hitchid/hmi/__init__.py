"""The operator's page: runs the bench, watches it, identifies, and shows what was found.

Three kinds of processes: the bench loop with source, recorder and safety; the server of the page; models and
commands beside them. A page is a client that may die. The server is imported where it is started.
"""

from hitchid.hmi.source import Reading as Reading
from hitchid.hmi.source import Signal as Signal
from hitchid.hmi.source import Source as Source

__all__ = ["Reading", "Signal", "Source"]
