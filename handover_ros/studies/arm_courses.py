"""Courses with the arm of seven joints, bicycle handlebars and U-lock (Bestick 2017, sections 4.6 and 4.7)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from handover_ros.arm.model import Arm, load_arm
from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.geometry import FloatArray, transform_from_xyz_rpy
from handover_ros.objects.catalogue import ObjectModel, load_object
from handover_ros.preferences.offered import free_for_hand, offered_query
from handover_ros.preferences.query import Query
from handover_ros.preferences.space import PreferenceSpace, arm_space
from handover_ros.robot import RobotModel
from handover_ros.robot.gripper_points import gripper_points
from handover_ros.robot.robot_geometry import RobotGeometry
from handover_ros.studies.chapter4_settings import ArmSettings, Chapter4Settings
from handover_ros.studies.heldout import heldout
from handover_ros.studies.learning import Course
from handover_ros.studies.planar_courses import Learned
from handover_ros.studies.seeds import anybody, generator

TRIES = 3000  # of poses until the person can take the object


@dataclass(frozen=True, eq=False)
class Offering:
    """What offers are made of.

    Attributes:
        settings: Where offers are made.
        arm: The person's.
        models: The objects.
        gripper: Points of the robot's gripper (n, 3) [m].
    """

    settings: ArmSettings
    arm: Arm
    models: tuple[ObjectModel, ...]
    gripper: FloatArray

    def query(self, model: ObjectModel, rng: np.random.Generator) -> Query:
        """Return an object at a random pose, held by a random grasp of the robot, as the person could take it.

        Raises:
            BadModelError: No pose was found.
        """
        settings = self.settings
        least = len(model.human_grasps) if settings.every_grasp else 1
        for _ in range(TRIES):
            turn = rng.uniform([-settings.tilt, -settings.tilt, -np.pi], [settings.tilt, settings.tilt, np.pi])
            pose = transform_from_xyz_rpy(rng.uniform(settings.least, settings.most), turn)
            grasp = model.robot_grasps[int(rng.integers(len(model.robot_grasps)))]
            held = grasp.region.sample(rng, 1)[0]
            try:
                free = free_for_hand(model, self.arm, self.gripper, held)
                found = offered_query(model, self.arm, pose, free, model.name, settings.configurations)
            except BadRequestError:
                continue
            if len(found) >= settings.least_configurations and len(np.unique(found.region)) >= least:
                return found
        raise BadModelError(
            f"studies/chapter4: the person could take {model.name} at none of {TRIES} random poses; widen arm.least, "
            "arm.most, or lower arm.least_configurations"
        )


def with_grasps(model: ObjectModel, names: tuple[str, ...]) -> ObjectModel:
    """Return an object of which only some grasp regions are used.

    Raises:
        UnknownNameError: It has no such region.
    """
    regions = {region.name: region for region in model.human_grasps}
    for name in names:
        if name not in regions:
            raise UnknownNameError(f"grasp region of {model.name}", name, list(regions))
    return replace(model, human_grasps=tuple(regions[name] for name in names))


def offering(settings: ArmSettings) -> Offering:
    """Return what offers are made of."""
    models = tuple(with_grasps(load_object(name), names) for name, names in settings.grasps.items())
    return Offering(settings, load_arm(settings.name, settings.side), models, _gripper(settings.robot))


@lru_cache(maxsize=2)
def _gripper(robot_name: str) -> FloatArray:
    """Return the points (n, 3) of a robot's gripper, made once a process."""
    robot = RobotModel.load(robot_name)
    return gripper_points(RobotGeometry(robot), robot.arm_names[0])


def seven_space(settings: Chapter4Settings, learned: Learned) -> PreferenceSpace:
    """Return what is learned of a person with an arm of seven joints; the rest is as anybody's."""
    limits = load_arm(settings.arm.name, settings.arm.side).limits
    return arm_space(limits, (learned,), rationality=settings.rationality)


def arm_course(settings: Chapter4Settings, learned: Learned, person: int, seed: int) -> Course:
    """Return one person's course: a random truth, a menu of random offers, others to test with (figure 4.8)."""
    scenario = f"arm_{learned}"
    rng = generator(seed, scenario, person)
    space, offers = seven_space(settings, learned), offering(settings.arm)
    truth = anybody(space, rng)
    # As many of each object, so that a preference for one shows; of an odd number one more of the first.
    menu = tuple(offers.query(offers.models[place % 2], rng) for place in range(settings.menu))
    tests = [offers.query(offers.models[place % 2], rng) for place in range(settings.arm.test_poses)]
    return Course(
        scenario=scenario,
        person=person,
        space=space,
        truth=truth,
        menu=menu,
        tests=heldout(tests, space.people(truth[None]), rng),
        levels=rng.random(settings.arm.queries),
        particles=settings.particles,
        seed=int(rng.integers(2**31)),
        information_weight=settings.information_weight,
    )


def user_course(settings: Chapter4Settings, person: int, seed: int) -> Course:
    """Return one person's course in the simulated user study: only the grip that is taken is seen (figure 4.10)."""
    study = settings.user_study
    rng = generator(seed, "user_study", person)
    space, offers = seven_space(settings, "neutral"), offering(settings.arm)
    truth = anybody(space, rng)
    menu = tuple(offers.query(model, rng) for model in offers.models for _ in range(study.poses))
    tests = [offers.query(model, rng) for model in offers.models for _ in range(study.test_poses)]
    return Course(
        scenario="user_study",
        person=person,
        space=space,
        truth=truth,
        menu=menu,
        tests=heldout(tests, space.people(truth[None]), rng, by_region=True),
        levels=rng.random(study.queries),
        particles=settings.particles,
        seed=int(rng.integers(2**31)),
        answers="region",
    )
