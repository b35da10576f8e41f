"""Planning: schemes that choose where to offer an object, and the robot's motion from the table to the person."""

from handover_ros.planning.handover import HandoverPlanner
from handover_ros.planning.motion import MotionPlanner
from handover_ros.planning.offers import Offer, Scheme
from handover_ros.planning.personal import PersonalScheme
from handover_ros.planning.schemes import ConstantScheme, RelativeScheme, load_scheme, load_schemes
from handover_ros.planning.types import (
    CellSnapshot,
    ExpectedPosture,
    HandoverPlan,
    HandoverRequest,
    PlannedStage,
    PlannerSettings,
    TrackedPerson,
)

__all__ = [
    "CellSnapshot",
    "ConstantScheme",
    "ExpectedPosture",
    "HandoverPlan",
    "HandoverPlanner",
    "HandoverRequest",
    "MotionPlanner",
    "Offer",
    "PersonalScheme",
    "PlannedStage",
    "PlannerSettings",
    "RelativeScheme",
    "Scheme",
    "TrackedPerson",
    "load_scheme",
    "load_schemes",
]
