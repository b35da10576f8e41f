"""Planning: schemes that choose where to offer an object, and the robot's motion from the table to the person."""

from handover_ros.planning.handover import HandoverPlanner
from handover_ros.planning.motion import MotionPlanner
from handover_ros.planning.schemes import ConstantScheme, Offer, RelativeScheme, Scheme, load_scheme, load_schemes
from handover_ros.planning.types import CellSnapshot, HandoverPlan, HandoverRequest, PlannedStage, PlannerSettings

__all__ = [
    "CellSnapshot",
    "ConstantScheme",
    "HandoverPlan",
    "HandoverPlanner",
    "HandoverRequest",
    "MotionPlanner",
    "Offer",
    "PlannedStage",
    "PlannerSettings",
    "RelativeScheme",
    "Scheme",
    "load_scheme",
    "load_schemes",
]
