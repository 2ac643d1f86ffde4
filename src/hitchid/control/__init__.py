"""Position control of a hitch: design from a model, and proof on the virtual bench."""

from hitchid.control.closed_loop import ClosedLoops as ClosedLoops
from hitchid.control.closed_loop import Plant as Plant
from hitchid.control.closed_loop import PositionController as PositionController
from hitchid.control.closed_loop import Surroundings as Surroundings
from hitchid.control.closed_loop import run_closed_loops as run_closed_loops
from hitchid.control.closed_loop import run_plant_loops as run_plant_loops
from hitchid.control.controller import ControllerState as ControllerState
from hitchid.control.controller import Gains as Gains
from hitchid.control.controller import HitchController as HitchController
from hitchid.control.controller import HoldWindow as HoldWindow
from hitchid.control.drive import Drive as Drive
from hitchid.control.drive import Figures as Figures
from hitchid.control.drive import drive as drive
from hitchid.control.files import ControllerFile as ControllerFile
from hitchid.control.files import load_controller as load_controller
from hitchid.control.files import save_controller as save_controller
from hitchid.control.loops import DirectionMargins as DirectionMargins
from hitchid.control.loops import Margins as Margins
from hitchid.control.loops import margins as margins
from hitchid.control.prediction import ModelPlant as ModelPlant
from hitchid.control.scenarios import Kind as Kind
from hitchid.control.scenarios import PidController as PidController
from hitchid.control.scenarios import Scenario as Scenario
from hitchid.control.scenarios import baselines as baselines
from hitchid.control.scenarios import scenarios as scenarios
from hitchid.control.tuning import Limitation as Limitation
from hitchid.control.tuning import OpenLoop as OpenLoop
from hitchid.control.tuning import TrialRun as TrialRun
from hitchid.control.tuning import Tuning as Tuning
from hitchid.control.tuning import limitation as limitation
from hitchid.control.tuning import tune as tune

__all__ = [
    "ClosedLoops",
    "ControllerFile",
    "ControllerState",
    "DirectionMargins",
    "Drive",
    "Figures",
    "Gains",
    "HitchController",
    "HoldWindow",
    "Kind",
    "Limitation",
    "Margins",
    "ModelPlant",
    "OpenLoop",
    "PidController",
    "Plant",
    "PositionController",
    "Scenario",
    "Surroundings",
    "TrialRun",
    "Tuning",
    "baselines",
    "drive",
    "limitation",
    "load_controller",
    "margins",
    "run_closed_loops",
    "run_plant_loops",
    "save_controller",
    "scenarios",
    "tune",
]
