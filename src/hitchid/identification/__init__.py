"""Identification: dead zones, phase 1, phase 2; `identify` is the way in."""

from hitchid.estimation.search import DifferentialEvolution as DifferentialEvolution
from hitchid.estimation.search import MultiStart as MultiStart
from hitchid.estimation.search import Search as Search
from hitchid.estimation.search import Whale as Whale
from hitchid.identification.case import Identification as Identification
from hitchid.identification.descent import Descent as Descent
from hitchid.identification.direction import ChannelTrace as ChannelTrace
from hitchid.identification.identify import identify as identify
from hitchid.identification.identify import identify_many as identify_many
from hitchid.identification.phase2 import Training as Training
from hitchid.identification.rollouts import Gate as Gate
from hitchid.identification.rollouts import Rollouts as Rollouts
from hitchid.identification.selection import Automatic as Automatic
from hitchid.identification.settings_file import Settings as Settings
from hitchid.identification.settings_file import read_settings as read_settings
from hitchid.structures import Form as Form
