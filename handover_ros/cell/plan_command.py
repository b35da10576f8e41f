"""``handover plan``: one handover planned without a graph: who would take it where; what other schemes would give."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from handover_ros.cell.late_progress import LateProgress
from handover_ros.cell.report import output_folder, write_json
from handover_ros.cell.track_command import named_profile
from handover_ros.errors import BadRequestError, HandoverError, UnknownNameError
from handover_ros.geometry import FloatArray, make_transform, transform_from_xyz_rpy, transform_points
from handover_ros.objects import load_catalogue, load_scene
from handover_ros.objects.scene import Scene
from handover_ros.planning import CellSnapshot, HandoverPlanner, HandoverRequest, PlannerSettings, TrackedPerson
from handover_ros.planning.expected_cost import ExpectedCostScheme
from handover_ros.planning.explain import MODELS, explain
from handover_ros.planning.handover import Search
from handover_ros.planning.judge import judge
from handover_ros.planning.picking import Picking
from handover_ros.planning.plan_picture import ShownPlan, Surroundings, draw_plans
from handover_ros.planning.schemes import load_schemes
from handover_ros.planning.types import HandoverPlan, PredictedChoice
from handover_ros.robot import RobotModel
from handover_ros.sim.person_kinematics import PersonKinematics
from handover_ros.sim.person_spec import load_person

MEASURE = "expected_cost"  # the scheme whose costs count when the chosen one has none
PICTURED = ("maximum_feasibility", "minimum_mean", "expected_cost")
OTHERS = ("expected_cost", "minimum_mean", "maximum_feasibility", "relative", "hip_offset", "constant")
WITH_PROFILE = "personal"
TOLD_PROBABILITY, TOLD_GRASPS = 0.005, 8
WRIST_BEHIND = 0.11  # [m] from the tips of the gripper to where the robot's arm is drawn to


@dataclass(frozen=True)
class PlanRequest:
    """What ``handover plan`` was asked for.

    Attributes:
        object_name: As in ``config/objects``.
        scheme: As in ``config/schemes``.
        person: Who stands at the scene's place, a file of ``config/people``; only the torso is known.
        profile: Stored profile, or a profile's file, whose skeleton is known; empty: none.
        person_model: MN, MP, GN or GP; empty: the scheme's.
        goal: x, y, z [m], roll, pitch, yaw [rad] of the object in the world; None: the scene's.
        no_goal: There is none, not even the scene's.
        arm: Of the robot; empty: the planner chooses.
        scene: A file of ``config/scenes``.
        robot: A file of ``config/robots``.
        budget: Wall time [s] of one plan; 0: the planner's default.
        seed: Of the random searches for motions.
        json_file: Where to write the numbers too.
        out: Folder of everything written.
    """

    object_name: str
    scheme: str = MEASURE
    person: str = "adult"
    profile: str = ""
    person_model: str = ""
    goal: tuple[float, ...] | None = None
    no_goal: bool = False
    arm: str = ""
    scene: str = "lab"
    robot: str = "baxter"
    budget: float = 0.0
    seed: int = 0
    json_file: Path | None = None
    out: Path | None = None


@dataclass(frozen=True, eq=False)
class Compared:
    """What one scheme gives.

    Attributes:
        scheme: Its name.
        plan: None: it found nothing.
        judged: How the person would choose, by the measure that is the same for all; None: not at all.
        problem: Why there is no plan, or no choice; empty: there is.
    """

    scheme: str
    plan: HandoverPlan | None
    judged: PredictedChoice | None
    problem: str = ""

    @property
    def cost(self) -> float:
        """Expected cost; NaN: none."""
        return float("nan") if self.judged is None else self.judged.expected_cost

    @property
    def hand_cost(self) -> float:
        """Expected cost at the handover; NaN: none."""
        return float("nan") if self.judged is None else self.judged.hand_cost

    @property
    def goal_cost(self) -> float:
        """Expected cost at the goal, that of taking the object anew included; NaN: no goal."""
        goal = self.plan is not None and self.plan.world_from_goal is not None
        return self.cost - self.hand_cost if goal else float("nan")


class Comparison:
    """Plans one handover with several schemes and judges all alike.

    Args:
        request: What was asked for.

    Attributes:
        planner: The planner.
        cell: The cell at rest, with the person.
        goal: Object pose to which the person brings it, or None.
    """

    def __init__(self, request: PlanRequest) -> None:
        self.request = request
        if request.person_model and request.person_model not in MODELS:
            raise UnknownNameError("person model", request.person_model, tuple(MODELS))
        scene, robot = load_scene(request.scene), RobotModel.load(request.robot)
        settings = PlannerSettings(seed=request.seed)
        self.planner = HandoverPlanner(robot, scene, load_catalogue(), load_schemes(), settings)
        self.model = self.planner.motion.object_model(request.object_name)
        self.goal = _goal(request, scene)
        chosen = self.planner.scheme(request.scheme)
        measure = chosen if isinstance(chosen, ExpectedCostScheme) else self.planner.scheme(MEASURE)
        if not isinstance(measure, ExpectedCostScheme):
            raise BadRequestError(f"scheme {MEASURE!r} has no cost by which others could be judged")
        self.measure = measure
        arms = {arm: np.array(robot.arm(arm).home) for arm in robot.arm_names}
        self.cell = CellSnapshot(arms, dict(scene.placements), _person(request, scene))

    def compared(self, scheme: str) -> Compared:
        """Return what a scheme gives.

        Raises:
            HandoverError: It found no plan, or something is unknown.
        """
        request = HandoverRequest(
            self.request.object_name, scheme, self.request.arm, self.request.budget, self.goal,
            self.request.person_model,
        )  # fmt: skip
        plan = self.planner.plan(request, self.cell)
        search = Search(float("inf"))
        picking = Picking(self.planner.motion, plan.arm, plan.object_name, self.cell, search.picking)
        task = self.planner.task(request, self.model, picking, self.cell, search)
        judged = judge(self.measure, task, plan.world_from_object, plan.object_from_gripper)
        problem = (
            ""
            if judged
            else "this person could not take it there" + (" and place it" if task.world_from_goal is not None else "")
        )
        return Compared(scheme, plan, judged, problem)

    def shown(self, entry: Compared) -> ShownPlan | None:
        """Return a plan for the picture; None: there is no choice to show."""
        plan, predicted = entry.plan, entry.judged
        if plan is None or predicted is None:
            return None
        widths = {grasp.region.name: grasp.width for grasp in self.model.robot_grasps}
        wrist = transform_points(plan.world_from_gripper, np.array([0.0, 0.0, -WRIST_BEHIND]))
        posture = plan.stage("present").trajectory.positions[-1]
        arm = np.vstack([joint_places(self.planner.motion.robot, plan.arm, posture), wrist])
        jaws = widths.get(plan.robot_grasp, 0.04)
        title = entry.scheme.replace("_", " ").capitalize()
        return ShownPlan(title, predicted, plan.world_from_object, plan.world_from_gripper, jaws, arm)


def run_plan(request: PlanRequest, console: Console) -> int:
    """Plan, tell, draw and write; return the exit status.

    Raises:
        HandoverError: Bad input, or the chosen scheme finds nothing.
    """
    with LateProgress(console, "planning") as bar:
        comparison = Comparison(request)
        comparison.planner.warm_up()
        ours = comparison.compared(request.scheme)
        known = comparison.planner.schemes
        names = [*OTHERS, *([WITH_PROFILE] if request.profile else [])]
        others = [name for name in names if name in known and name != request.scheme]
        entries = [ours]
        for number, name in enumerate(others):
            bar.update((number + 1.0) / (len(others) + 1.0), name)
            entries.append(_compared_or_told(comparison, name))
    plan = ours.plan
    assert plan is not None
    folder = output_folder(request.out, "plan")
    metrics = metrics_of(entries)
    console.print(_whole_explanation(plan, ours.judged), highlight=False, markup=False, soft_wrap=True)
    if ours.judged is not None:
        console.print(grasp_table(ours.judged))
    console.print(robot_line(plan), highlight=False, markup=False, soft_wrap=True)
    console.print(comparison_table(entries))
    for entry in filter(lambda each: each.problem, entries):
        console.print(f"{entry.scheme}: {entry.problem}", highlight=False, markup=False, soft_wrap=True)
    files = _draw(comparison, entries, folder)
    for target in filter(None, (folder / "plan.json", request.json_file)):
        problems = {entry.scheme: entry.problem for entry in entries if entry.problem}
        write_json(target, "plan", True, request.seed, metrics, files=files, folder=str(folder),
                   explanation=plan.explanation, arm=plan.arm, robot_grasp=plan.robot_grasp,
                   world_from_object=np.round(plan.world_from_object, 6).tolist(), problems=problems)  # fmt: skip
    console.print(f"everything is in {folder}", highlight=False, markup=False, soft_wrap=True)
    return 0


def metrics_of(entries: Sequence[Compared]) -> dict[str, float]:
    """Return the numbers; the first entry is the plan that was asked for."""
    ours = entries[0]
    plan, predicted = ours.plan, ours.judged
    assert plan is not None
    nan = float("nan")
    metrics = {
        "expected_cost": ours.cost,
        "hand_cost": ours.hand_cost,
        "goal_cost": ours.goal_cost,
        "planning_s": plan.planning_time,
        "candidates": plan.candidates,
        "goal_infeasible": predicted.goal_infeasible if predicted else nan,
        "most_probable": predicted.grasps[0].probability if predicted else nan,
        "grasps": len(predicted.grasps) if predicted else 0,
    }
    metrics |= {f"cost_{entry.scheme}": entry.cost for entry in entries}
    metrics |= {f"cost_over_{entry.scheme}": _ratio(ours.cost, entry.cost) for entry in entries[1:]}
    return metrics


def grasp_table(predicted: PredictedChoice) -> Table:
    """Return the table of the likely grasps."""
    table = Table(title=f"Likely grasps ({predicted.cost_name} cost)", title_justify="left", box=SIMPLE_HEAD)
    for heading in ("region", "hand"):
        table.add_column(heading)
    with_goal = predicted.goal_infeasible > 0.0 or any(math.isfinite(each.goal_cost) for each in predicted.grasps)
    for heading in ("probability", "cost now", *(("cost at the goal",) if with_goal else ())):
        table.add_column(heading, justify="right")
    told = [grasp for grasp in predicted.grasps[:TOLD_GRASPS] if grasp.probability >= TOLD_PROBABILITY]
    for grasp in told or predicted.grasps[:1]:
        later = f"{grasp.goal_cost:.2f}" if math.isfinite(grasp.goal_cost) else "cannot be placed"
        now = (f"{grasp.probability:.1%}", f"{grasp.hand_cost:.2f}")
        table.add_row(grasp.region, " and ".join(grasp.hands), *now, *((later,) if with_goal else ()))
    return table


def robot_line(plan: HandoverPlan) -> str:
    """Return one line on what the robot does."""
    place = ", ".join(f"{value:.2f}" for value in plan.world_from_object[:3, 3])
    angles = Rotation.from_matrix(plan.world_from_object[:3, :3]).as_euler("xyz", degrees=True)
    turn = ", ".join(f"{angle:.0f}" for angle in angles)
    return (
        f"robot: {plan.arm} arm, grasp {plan.robot_grasp}, object at ({place}) m, roll, pitch, yaw ({turn}) deg; "
        f"planned in {plan.planning_time:.2f} s, candidates {plan.candidates}"
    )


def comparison_table(entries: Sequence[Compared]) -> Table:
    """Return the table of what the schemes give; the first entry is the plan that was asked for."""
    table = Table(title="What the others would give", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("scheme", no_wrap=True)
    for heading in ("expected cost", "now", "at the goal", "times ours"):
        table.add_column(heading, justify="right")
    for entry in entries:
        values = (entry.cost, entry.hand_cost, entry.goal_cost, _ratio(entry.cost, entries[0].cost))
        name = f"{entry.scheme} (ours)" if entry is entries[0] else entry.scheme
        table.add_row(name, *(f"{value:.2f}" if math.isfinite(value) else "" for value in values))
    return table


def joint_places(robot: RobotModel, arm: str, displacements: FloatArray) -> FloatArray:
    """Return the places of an arm's joints in the world [m] (n, 3), by the product of exponentials."""
    axes, origins, _ = robot.chain(arm)
    moved, places = np.eye(4), []
    for axis, origin, angle in zip(axes, origins, displacements, strict=True):
        places.append(transform_points(moved, origin))
        turn = Rotation.from_rotvec(angle * axis).as_matrix()
        moved = moved @ make_transform(turn, origin - turn @ origin)
    return np.array(places)


def _goal(request: PlanRequest, scene: Scene) -> FloatArray | None:
    """Return the object's pose at the goal, or None."""
    if request.goal is None:
        return None if request.no_goal else scene.goals.get(request.object_name)
    if request.no_goal:
        raise BadRequestError("--goal and --no-goal exclude each other; give one of them")
    if len(request.goal) != 6 or not np.isfinite(request.goal).all():
        raise BadRequestError(f"--goal: needs six finite numbers, x y z [m] roll pitch yaw [rad], got {request.goal}")
    if max(map(abs, request.goal[3:])) > 2.0 * np.pi:
        raise BadRequestError(f"--goal: roll pitch yaw are radians, at most a full turn (6.28), got {request.goal[3:]}")
    return transform_from_xyz_rpy(request.goal[:3], request.goal[3:])


def _person(request: PlanRequest, scene: Scene) -> TrackedPerson:
    """Return the person at the scene's place, known by the torso, or by a profile too."""
    spec = load_person(request.person)
    torso = PersonKinematics(spec, scene.person_pose).torso_pose(spec.standing[:6])
    person = TrackedPerson(torso)
    if not request.profile:
        return person
    profile = named_profile(request.profile)
    return replace(person, skeleton=profile.skeleton, profile=profile.profile_id)


def _compared_or_told(comparison: Comparison, scheme: str) -> Compared:
    """Return what a scheme gives, or why it gives nothing."""
    try:
        return comparison.compared(scheme)
    except HandoverError as error:
        return Compared(scheme, None, None, str(error))


def _whole_explanation(plan: HandoverPlan, judged: PredictedChoice | None) -> str:
    """Return the plan's explanation, with the person's choice where the scheme knows nothing of it."""
    return plan.explanation if plan.predicted or judged is None else f"{plan.explanation} {explain(judged)}"


def _ratio(cost: float, other: float) -> float:
    """Return one cost over another; NaN where there is none."""
    return cost / other if math.isfinite(cost) and math.isfinite(other) and other > 0.0 else float("nan")


def _draw(comparison: Comparison, entries: Sequence[Compared], folder: Path) -> list[Path]:
    """Draw the pictured schemes, and the chosen one below them, and return the files."""
    by_name = {entry.scheme: entry for entry in entries}
    names = [*(name for name in PICTURED if name != entries[0].scheme), entries[0].scheme]
    found = [by_name[name] for name in names if name in by_name]
    shown = [each for each in map(comparison.shown, found) if each is not None]
    if not shown:
        return []
    scene, goal = comparison.planner.motion.scene, comparison.goal
    person = comparison.cell.person
    assert person is not None
    boxes = [box for box in scene.boxes if box.name.startswith(scene.default_goal_surface)] if goal is not None else []
    around = Surroundings(comparison.model, person.world_from_torso, goal, boxes)
    who = person.profile or comparison.request.person
    kind = MODELS.get(shown[-1].predicted.person_model, shown[-1].predicted.person_model)
    title = f"{comparison.model.name.replace('_', ' ')} for {who}, who is {kind}"
    return [draw_plans(folder / "plan.png", shown, around, title)]
