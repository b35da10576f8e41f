"""What the simulated person does: a phase at a time, each of which says what comes next."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import mujoco
import numpy as np

from handover_ros.errors import UnknownNameError
from handover_ros.geometry import FloatArray, invert_transform
from handover_ros.sim.calibration_motions import MotionPlan, calibration_plan
from handover_ros.sim.person_actuation import PersonActuation
from handover_ros.sim.person_motion import MovementSequence, minimum_jerk
from handover_ros.sim.person_plans import LIFT, RELEASE_HEIGHT, Carrying, PathPlanner, backed_off, raised
from handover_ros.sim.person_reach import APPROACH, GraspChooser, Takeable, Taking
from handover_ros.sim.person_spec import HANDS, PersonSpec
from handover_ros.sim.person_view import PersonView

BEHAVIOURS = ("stand", "calibrate", "take", "ignore", "drop")
APPROACH_TIME = 0.55
LOWERING_TIME = 0.9
RETREAT_TIME = 0.6
RETURN_TIME = 1.3
OFFER_GRACE = 0.4
FASTEST_OFFER = 0.25
FARTHEST_MOVED = 0.06
SETTLED_POSITION, SETTLED_ANGLE = 0.004, 0.05
LONGEST_SETTLING = 1.2
LONGEST_CLOSING = 2.0
PULL_RISE = 0.5
PULL_REST = 1.5
LONGEST_DRAG = 0.12
RELEASED_FOR = 0.15  # [s] the object must be free before the person moves it
CLEARED = 0.25  # [m] the gripper must have moved away: the way to the goal may cross the arm
LONGEST_CLEARING = 4.0  # [s] the person waits for that
NEXT_TRY = 1.5


class PersonBehaviour:
    """Decides and moves one person, phase by phase.

    Args:
        person: Who it is.
        body: What it moves.
        chooser: How it chooses grasps.
        planner: How it plans its hands' paths.
        catalogue: Objects it can take.
        gripper_sites: Robot arm to the site of its gripper: the hands keep clear of it.
        rng: Source of the noise of choices.

    Attributes:
        behaviour: One of ``BEHAVIOURS``.
        phase: What it is doing: ``standing``, ``calibrating``, ``reaching``, ``approaching``, ``closing``, ``pulling``,
            ``moving``, ``lowering``, ``releasing``, ``retreating``, ``returning`` or ``holding``.
        grip_request: Hand to the object it wants to hold now, or None.
        taking: The last decision how to take an object, None before the first one.
    """

    def __init__(
        self,
        person: PersonSpec,
        body: PersonActuation,
        chooser: GraspChooser,
        planner: PathPlanner,
        catalogue: Mapping[str, Takeable],
        gripper_sites: Mapping[str, int],
        rng: np.random.Generator,
    ) -> None:
        self.person = person
        self._body, self._chooser, self._planner = body, chooser, planner
        self._catalogue, self._gripper_sites, self._rng = catalogue, gripper_sites, rng
        self.behaviour = "take"
        self.phase = "standing"
        self.grip_request: dict[str, str | None] = dict.fromkeys(HANDS)
        self.taking: Taking | None = None
        self._motions: deque[MotionPlan] = deque()
        self._phase_start = 0.0
        self._offer_since: float | None = None
        self._offer_seen = -np.inf
        self._next_try = -np.inf
        self._offered_at = np.eye(4)
        self._released_since: float | None = None
        self._grippers_at_release = np.zeros(0)
        # Hands of the present object: wanted grips, grips when it was taken, and how they hold it.
        self._targets: dict[str, FloatArray] = {}
        self._grips: dict[str, FloatArray] = {}
        self._held: dict[str, FloatArray] = {}
        self._path = np.zeros((0, 20))
        self._carrying: Carrying | None = None

    def choose(self, behaviour: str, motion: str = "") -> float:
        """Choose what the person does from now on; what it holds it first puts down.

        Args:
            behaviour: One of ``BEHAVIOURS``.
            motion: For ``calibrate``: one calibration motion, or all in order when empty.

        Returns:
            How long the calibration motions take [s]; 0 otherwise.

        Raises:
            UnknownNameError: There is no such behaviour or motion.
        """
        if behaviour not in BEHAVIOURS:
            raise UnknownNameError("behaviour", behaviour, BEHAVIOURS)
        plans = calibration_plan(self.person, motion) if behaviour == "calibrate" else ()
        self.behaviour = behaviour
        self._motions = deque(plans)
        return sum(plan.duration for plan in plans)

    def update(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Look whether the phase is over, and steer the body on."""
        getattr(self, f"_{self.phase}")(data, time, view)

    # The phases. Each one looks whether it is over, and then enters the next one.

    def _standing(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Wait for something to do."""
        if self._motions:
            plan = self._motions.popleft()
            self._body.follow(MovementSequence(time, plan.times, plan.postures))
            self._enter("calibrating", time)
            return
        if self.behaviour == "calibrate":
            self.behaviour = "stand"
        if self.behaviour not in ("take", "drop") or view.offered not in self._catalogue or time < self._next_try:
            self._offer_since = None
            return
        if self._offer_since is None:
            self._offer_since = time
        elif time - self._offer_since >= self.person.timing.reaction:
            self._offer_since = None
            self._decide(data, time, view)

    def _calibrating(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Go on with the motion."""
        if self._body.at_rest(time):
            self._enter("standing", time)
        elif not self._motions and self.behaviour != "calibrate":
            self._return(time)

    def _decide(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Choose hand and grasp and start to reach, or leave it for a while."""
        name = view.offered
        assert name is not None
        model, pose, base = self._catalogue[name], view.objects[name], self._body.base
        arm = view.held_by_robot.get(name)
        sites = self._gripper_sites if arm is None or model.hands == 2 else {arm: self._gripper_sites.get(arm, -1)}
        grippers = [_site_pose(data, site) for site in sites.values() if site >= 0]
        goal = view.goals.get(name)
        taking = self._chooser.choose(model, pose, goal, grippers, self._body.posture(), base, self._rng)
        if taking is None:
            self._next_try = time + NEXT_TRY
            return
        self.taking = taking
        self._offered_at = pose.copy()
        self._offer_seen = time
        self._targets = {grasp.hand: pose @ grasp.object_from_hand for grasp in taking.grasps}
        self._path = self._planner.approach(taking.posture, base, self._targets)
        self._body.move_to(time, self.person.timing.reach, self._path[0])
        self._enter("reaching", time)

    def _reaching(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Bring the hand before the grasp."""
        if not self._offer_stands(time, view):
            self._return(time)
        elif self._body.done(time) > 0.88:
            # The approach overlaps the end of the reach, as two submovements do.
            self._body.run(time, APPROACH_TIME, self._path, overlapping=True)
            self._enter("approaching", time)

    def _approaching(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Bring the hand onto the object along the palm normal, by sight."""
        if not self._offer_stands(time, view):
            self._return(time)
            return
        error = self._guide_to_grasp(data, time, view)
        late = time - self._phase_start > APPROACH_TIME + LONGEST_SETTLING
        if self._body.at_rest(time) and (_small(error) or late):
            for hand in self._targets:
                self.grip_request[hand] = self._taken
                self._body.close(hand)
            self._enter("closing", time)

    def _closing(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Close the hand until the object is held."""
        if all(view.held_by_hand.get(hand) == self._taken for hand in self._targets):
            self._grips = {hand: self._body.hand_pose(data, hand) for hand in self._targets}
            self._released_since = None
            self._enter("pulling", time)
        elif time - self._phase_start > LONGEST_CLOSING or not self._offer_stands(time, view):
            self._return(time)
        else:
            self._guide_to_grasp(data, time, view)

    def _pulling(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Pull at the object until the robot lets go; rest now and then."""
        if not self._still_held(time, view):
            return
        dragged = max(
            float(np.linalg.norm(self._body.hand_pose(data, hand)[:3, 3] - grip[:3, 3]))
            for hand, grip in self._grips.items()
        )
        if self._taken in view.held_by_robot:
            self._released_since = None
            if dragged > LONGEST_DRAG:
                self._return(time)
                return
            timing = self.person.timing
            within = (time - self._phase_start) % (timing.patience + PULL_REST)
            strength = minimum_jerk(within / PULL_RISE) - minimum_jerk((within - timing.patience) / PULL_RISE)
            self._body.pull(self._targets, strength * timing.pull_force / len(self._targets))
            return
        if self._released_since is None:
            self._released_since = time
            self._grippers_at_release = self._gripper_distances(data, view)
            self._body.pull({}, 0.0)
            self._body.bear(self._taken, tuple(self._targets), time)
        elif self.behaviour == "drop" and time - self._released_since >= RELEASED_FOR:
            self._return(time)
        elif self._gripper_is_clear(data, time - self._released_since, view):
            self._carry(data, time, view)

    def _gripper_distances(self, data: mujoco.MjData, view: PersonView) -> FloatArray:
        """Return how far each gripper is from the taken object [m]."""
        grippers = np.array([data.site_xpos[site] for site in self._gripper_sites.values()]).reshape(-1, 3)
        return np.linalg.norm(grippers - view.objects[self._taken][:3, 3], axis=1)

    def _gripper_is_clear(self, data: mujoco.MjData, waited: float, view: PersonView) -> bool:
        """Return whether the robot that let go ``waited`` [s] ago has backed off, or has not for long enough."""
        distances = self._gripper_distances(data, view)
        if not len(distances) or waited > LONGEST_CLEARING:
            return waited >= RELEASED_FOR
        nearest = int(np.argmin(self._grippers_at_release))
        return bool(distances[nearest] - self._grippers_at_release[nearest] >= CLEARED)

    def _carry(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Plan the way to the goal and set off; without a goal, keep it."""
        pose = view.objects[self._taken]
        world_to_object = invert_transform(pose)
        self._held = {hand: world_to_object @ self._body.hand_pose(data, hand) for hand in self._targets}
        goal = view.goals.get(self._taken)
        plan = None
        if goal is not None:
            plan = self._planner.carry(self._body.command, self._body.base, pose, goal, self._held)
        if plan is None:
            self._enter("holding", time)
            return
        self._carrying = plan
        self._body.run(time, max(1.4, 1.875 * plan.length / self.person.timing.carry_speed), plan.points)
        self._enter("moving", time)

    def _holding(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Keep the object: there is nowhere to put it."""
        self._still_held(time, view)

    def _moving(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Bring the object over its goal."""
        if self._still_held(time, view) and self._body.at_rest(time):
            assert self._carrying is not None
            self._body.run(time, LOWERING_TIME, self._carrying.lowering)
            self._enter("lowering", time)

    def _lowering(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Put the object down by sight, then open the hand."""
        if not self._still_held(time, view):
            return
        done = minimum_jerk((time - self._phase_start) / LOWERING_TIME)
        assert self._carrying is not None
        wanted = raised(self._carrying.world_from_goal, RELEASE_HEIGHT + (1.0 - done) * (LIFT - RELEASE_HEIGHT))
        error = self._body.guide(data, {hand: wanted @ grip for hand, grip in self._held.items()})
        late = time - self._phase_start > LOWERING_TIME + LONGEST_SETTLING
        if self._body.at_rest(time) and (_small(error) or late):
            self._release()
            self._enter("releasing", time)

    def _releasing(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Open the hand and draw it back."""
        if self._taken in view.held_by_hand.values() or time - self._phase_start < self.person.timing.close:
            return
        hands = {hand: self._body.hand_pose(data, hand) for hand in self._targets}
        path = self._planner.retreat(self._body.command, self._body.base, hands)
        self._body.run(time, RETREAT_TIME, path)
        self._enter("retreating", time)

    def _retreating(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Draw the hand back from what was put down."""
        if self._body.at_rest(time):
            self._return(time)

    def _returning(self, data: mujoco.MjData, time: float, view: PersonView) -> None:
        """Come back to standing."""
        if self._body.at_rest(time):
            self._enter("standing", time)

    @property
    def _taken(self) -> str:
        """Name of the object that was decided on."""
        assert self.taking is not None
        return self.taking.object_name

    def _enter(self, phase: str, time: float) -> None:
        """Begin a phase."""
        self.phase = phase
        self._phase_start = time

    def _release(self) -> None:
        """Open the hands."""
        for hand in HANDS:
            self.grip_request[hand] = None
            self._body.open(hand)
        self._body.bear(None, (), 0.0)
        self._body.pull({}, 0.0)

    def _return(self, time: float) -> None:
        """Let go and go back to standing."""
        self._release()
        self._next_try = time + NEXT_TRY
        self._body.move_to(time, RETURN_TIME, self._body.standing)
        self._enter("returning", time)

    def _offer_stands(self, time: float, view: PersonView) -> bool:
        """Return whether the object is still where it was offered, and still wanted."""
        if self.behaviour not in ("take", "drop") or self._taken not in view.objects:
            return False
        if view.offered == self._taken:
            self._offer_seen = time
        moved = np.linalg.norm(view.objects[self._taken][:3, 3] - self._offered_at[:3, 3])
        slow = view.object_speed.get(self._taken, 0.0) < FASTEST_OFFER
        return bool(slow and moved < FARTHEST_MOVED and time - self._offer_seen < OFFER_GRACE)

    def _still_held(self, time: float, view: PersonView) -> bool:
        """Return whether all hands still hold the object; otherwise go back to standing."""
        if all(view.held_by_hand.get(hand) == self._taken for hand in self._targets):
            return True
        self._return(time)
        return False

    def _guide_to_grasp(self, data: mujoco.MjData, time: float, view: PersonView) -> FloatArray:
        """Steer the hands by sight to where they should be at this time of the approach; return the largest errors."""
        assert self.taking is not None
        start = self._phase_start if self.phase == "approaching" else -np.inf
        back = APPROACH * (1.0 - minimum_jerk((time - start) / APPROACH_TIME))
        pose = view.objects[self._taken]
        return self._body.guide(
            data, {grasp.hand: backed_off(pose @ grasp.object_from_hand, back) for grasp in self.taking.grasps}
        )


def _small(error: FloatArray) -> bool:
    """Return whether position [m] and angle [rad] errors (2,) are small enough to grasp."""
    return bool(error[0] < SETTLED_POSITION and error[1] < SETTLED_ANGLE)


def _site_pose(data: mujoco.MjData, site: int) -> FloatArray:
    """Return world_from_site (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3] = data.site_xmat[site].reshape(3, 3)
    pose[:3, 3] = data.site_xpos[site]
    return pose
