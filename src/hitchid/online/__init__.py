"""A model beside a running machine, sample by sample."""

from hitchid.online.live import Answer as Answer
from hitchid.online.live import Live as Live
