"""Identification: dead zones, phase 1, phase 2; the entry point is `identify`."""

from hitchid.estimation import DifferentialEvolution as DifferentialEvolution
from hitchid.estimation import MultiStart as MultiStart
from hitchid.estimation import Search as Search
from hitchid.estimation import Whale as Whale
from hitchid.estimation.training import AdamConfig as AdamConfig
from hitchid.identification.config import RivalsConfig as RivalsConfig
from hitchid.identification.dead_zone import from_ramps as from_ramps
from hitchid.identification.identify import DEFAULT_STRUCTURES as DEFAULT_STRUCTURES
from hitchid.identification.identify import PAPER_SPECS as PAPER_SPECS
from hitchid.identification.identify import TRAINING as TRAINING
from hitchid.identification.identify import WHALE as WHALE
from hitchid.identification.identify import identify as identify
from hitchid.identification.identify import identify_many as identify_many
from hitchid.identification.identify import train_rivals as train_rivals
from hitchid.identification.phase2 import CompensatorConfig as CompensatorConfig
from hitchid.identification.preparation import prepare as prepare
from hitchid.identification.result import ChannelTrace as ChannelTrace
from hitchid.identification.result import Identification as Identification
from hitchid.identification.selection import AutoStructure as AutoStructure
from hitchid.identification.settings_file import Settings as Settings
from hitchid.identification.settings_file import read_settings as read_settings
from hitchid.identification.settings_file import stamp_of as stamp_of
from hitchid.identification.speed_training import HoldoutTest as HoldoutTest
from hitchid.identification.speed_training import SpeedCompensatorConfig as SpeedCompensatorConfig
from hitchid.structures import ModelSpec as ModelSpec
