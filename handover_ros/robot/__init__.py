"""The robot: kinematics, collision checks, paths and trajectories (pinocchio, coal, TOPP-RA)."""

from handover_ros.robot.collision import CollisionChecker, HeldObject, Reason, Surroundings
from handover_ros.robot.inverse_kinematics import InverseKinematics
from handover_ros.robot.model import ArmModel, RobotModel
from handover_ros.robot.reach import Reach, Reasons
from handover_ros.robot.robot_geometry import RobotGeometry
from handover_ros.robot.shapes import Solid
from handover_ros.robot.trajectory import Trajectory, parameterise

__all__ = [
    "ArmModel",
    "CollisionChecker",
    "HeldObject",
    "InverseKinematics",
    "Reach",
    "Reason",
    "Reasons",
    "RobotGeometry",
    "RobotModel",
    "Solid",
    "Surroundings",
    "Trajectory",
    "parameterise",
]
