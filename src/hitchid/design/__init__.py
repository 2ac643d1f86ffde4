"""Optimal experiment design: the next test."""

from hitchid.design.next_test import Advice as Advice
from hitchid.design.next_test import ExcitationLimits as ExcitationLimits
from hitchid.design.next_test import Proposal as Proposal
from hitchid.design.next_test import command_of as command_of
from hitchid.design.next_test import design as design
from hitchid.design.next_test import write_command as write_command
