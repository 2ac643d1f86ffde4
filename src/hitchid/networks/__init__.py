"""Recurrent networks that correct the physical models, and the operating range of the tests."""

from hitchid.networks.error_compensator import COMPENSATOR_FEATURES as COMPENSATOR_FEATURES
from hitchid.networks.error_compensator import Compensator as Compensator
from hitchid.networks.lstm import LstmState as LstmState
from hitchid.networks.operating_range import RANGE_MARGIN as RANGE_MARGIN
from hitchid.networks.operating_range import OperatingRange as OperatingRange
from hitchid.networks.operating_range import SignalRange as SignalRange
from hitchid.networks.speed_compensator import SPEED_AUTHORITY as SPEED_AUTHORITY
from hitchid.networks.speed_compensator import SpeedCompensator as SpeedCompensator
