"""A first `campaign.toml` from logs alone: which column is which signal, in which unit, and why."""

from hitchid.proposal.propose import propose as propose
