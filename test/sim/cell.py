"""Helpers of the simulation's tests: one cell built once, and a robot that picks up an object by the book."""

from __future__ import annotations

import contextlib
from functools import cache

import numpy as np

from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects.catalogue import load_catalogue
from handover_ros.objects.scene import load_scene
from handover_ros.robot.model import RobotModel
from handover_ros.sim.options import SimulationOptions
from handover_ros.sim.simulation import Simulation

OFFERED = (0.90, 0.05, 1.10)  # [m] in world


@cache
def robot() -> RobotModel:
    return RobotModel.load("baxter")


def home_of(arm: str) -> np.ndarray:
    """Return the home posture of an arm [rad]."""
    return robot().arm(arm).home


@cache
def empty_cell() -> Simulation:
    """A cell without a person; every test resets it."""
    return Simulation(load_scene("lab"), seed=1, options=SimulationOptions(person="none"))


@cache
def staffed_cell() -> Simulation:
    """A cell with a person; every test resets it."""
    return Simulation(load_scene("lab"), seed=1)


def minimum_jerk(start: np.ndarray, end: np.ndarray, fastest: float = 1.0, points: int = 40):
    """Return times, positions and velocities of a straight joint motion, at most ``fastest`` [rad/s]."""
    duration = max(0.5, 1.875 * float(np.abs(end - start).max()) / fastest)
    times = np.linspace(0.0, duration, points)[1:]
    s = times / duration
    blend = 10 * s**3 - 15 * s**4 + 6 * s**5
    slope = (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
    return times, start + blend[:, None] * (end - start), slope[:, None] * (end - start)


def move(simulation: Simulation, arm: str, target: np.ndarray, fastest: float = 1.0) -> float:
    """Move an arm to joint displacements and return the greatest tracking error [rad]."""
    group = simulation.world.arms[arm]
    start = simulation.data.qpos[group.positions].copy()
    simulation.command_trajectory(group.names, *minimum_jerk(start, target, fastest))
    worst = 0.0
    now = simulation.time - simulation.clock_offset
    while simulation.robot.moving(now, arm):
        simulation.step()
        now = simulation.time - simulation.clock_offset
        commanded, _ = simulation.robot.commanded(now, arm)
        worst = max(worst, float(np.abs(simulation.data.qpos[group.positions] - commanded).max()))
    simulation.run(0.1)
    return worst


def joint_solution(arm: str, world_from_gripper: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return displacements that bring the gripper to a pose, by damped least squares from ``start``."""
    model = robot()
    limits = model.arm(arm)
    q = start.copy()
    for _ in range(300):
        pose = model.gripper_pose(arm, q)
        linear = world_from_gripper[:3, 3] - pose[:3, 3]
        angular = 0.5 * sum(np.cross(pose[:3, i], world_from_gripper[:3, i]) for i in range(3))
        error = np.concatenate([linear, angular])
        if np.linalg.norm(error) < 1e-5:
            return q
        jacobian = model.jacobian(arm, q)
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-4 * np.eye(6), error)
        q = np.clip(q + np.clip(step, -0.2, 0.2), limits.lower, limits.upper)
    raise AssertionError(f"no solution for the {arm} gripper at {world_from_gripper[:3, 3]}")


@cache
def presentation(name: str, arm: str, grasp: str) -> np.ndarray:
    """Return displacements that hold an upright object out to the person, in the direction that suits the arm."""
    region = next(item.region for item in load_catalogue()[name].robot_grasps if item.region.name == grasp)
    best = None
    for yaw in np.linspace(-np.pi, np.pi, 13):
        target = transform_from_xyz_rpy(OFFERED, (0.0, 0.0, yaw)) @ region.centre()
        with contextlib.suppress(AssertionError):
            solution = joint_solution(arm, target, home_of(arm))
            if best is None or np.abs(solution - home_of(arm)).max() < np.abs(best - home_of(arm)).max():
                best = solution
    assert best is not None, f"the {arm} arm cannot present the {name}"
    return best


def raised(pose: np.ndarray, height: float) -> np.ndarray:
    result = pose.copy()
    result[2, 3] += height
    return result


def pick(simulation: Simulation, name: str = "mug", arm: str = "left", grasp: str = "side", lift: float = 0.15) -> None:
    """Let the robot grasp an object where the scene placed it, and lift it."""
    model = load_catalogue()[name]
    region = next(item.region for item in model.robot_grasps if item.region.name == grasp)
    target = simulation.scene.placements[name] @ region.centre()
    at = joint_solution(arm, target, robot().arm(arm).home)
    back = target.copy()
    back[:3, 3] -= 0.1 * target[:3, 2]
    move(simulation, arm, joint_solution(arm, back, at))
    move(simulation, arm, at)
    simulation.command_gripper(arm, robot().arm(arm).opening[0], 15.0)
    simulation.run(1.0)
    move(simulation, arm, joint_solution(arm, raised(target, lift), at))
