"""The simulated cell as a whole: the same for the same seed, objects held and let go physically, faults, resets."""

import mujoco
import numpy as np
import pytest
from cell import empty_cell, home_of, move, pick, presentation, robot, staffed_cell

from handover_ros.errors import BadModelError, BadRequestError, UnknownNameError
from handover_ros.geometry import rotation_angle
from handover_ros.objects.scene import load_scene
from handover_ros.sim.options import SimulationOptions
from handover_ros.sim.simulation import Simulation


@pytest.fixture
def empty():
    simulation = empty_cell()
    simulation.enable(True)
    simulation.reset(seed=1)
    simulation.events()
    return simulation


@pytest.fixture
def staffed():
    simulation = staffed_cell()
    simulation.enable(True)
    simulation.reset(seed=1)
    simulation.events()
    simulation.frames()
    return simulation


def state(simulation):
    values = np.zeros(mujoco.mj_stateSize(simulation.model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(simulation.model, simulation.data, values, mujoco.mjtState.mjSTATE_INTEGRATION)
    return values


def eventful_second(simulation):
    """A second in which all parts have something to do."""
    names = robot().arm("left").joint_names
    target = home_of("left") + 0.2
    simulation.command_trajectory(names, [0.8], target[None], np.zeros((1, 7)))
    simulation.command_gripper("right", 0.02)
    simulation.set_behaviour("calibrate")
    simulation.run(1.0)
    frames = np.array([frame.positions for _, frame in simulation.frames()])
    return state(simulation), frames, simulation.object_poses()["mug"]


def kinds(events):
    return [event.kind for event in events]


def test_same_seed_and_commands_give_the_same_state_bit_for_bit(staffed):
    first = eventful_second(staffed)
    staffed.reset(seed=1)
    again = eventful_second(staffed)
    fresh = eventful_second(Simulation(load_scene("lab"), seed=1))
    for other in (again, fresh):
        np.testing.assert_array_equal(first[0], other[0])
        np.testing.assert_array_equal(first[1], other[1])
        np.testing.assert_array_equal(first[2], other[2])
    staffed.reset(seed=2)
    assert not np.array_equal(first[1], eventful_second(staffed)[1])


def test_start_time_moves_the_clock_and_nothing_else(staffed):
    first = eventful_second(staffed)
    later = Simulation(load_scene("lab"), seed=1, options=SimulationOptions(start_time=1.7e9))
    assert later.time == 1.7e9
    np.testing.assert_array_equal(eventful_second(later)[0], first[0])
    assert later.time == pytest.approx(1.7e9 + 1.0, abs=1e-5)


def test_clock_goes_on_over_a_reset(staffed):
    staffed.run(0.1)
    before = staffed.time
    staffed.reset()
    assert staffed.time == before
    frames_before = staffed.frames()[-1][1]
    staffed.run(0.1)
    assert staffed.frames()[0][1].device_time > frames_before.device_time


def test_marker_frames_come_at_their_rate_with_the_time_of_capture(staffed):
    staffed.run(1.0)
    frames = staffed.frames()
    times = np.array([time for time, _ in frames])
    assert len(frames) == pytest.approx(240, abs=1)
    assert np.all(np.diff(times) > 0.0)
    assert frames[0][1].positions.shape == (24, 3)


def test_perceived_objects_are_near_the_true_ones(empty):
    true = empty.truth().objects
    for name, pose in empty.object_poses().items():
        assert np.linalg.norm(pose[:3, 3] - true[name][:3, 3]) < 0.005
        assert rotation_angle(pose, true[name]) < 0.03


@pytest.mark.parametrize(
    ("name", "arm", "grasp"),
    [("mug", "left", "side"), ("plate", "right", "rim_turned"), ("pitcher", "right", "handle")],
)
def test_robot_grasps_and_lifts_without_a_jerk(empty, name, arm, grasp):
    pick(empty, name, arm, grasp)
    held = empty.truth()
    assert held.holders[name] == f"robot:{arm}"
    assert held.objects[name][2, 3] == pytest.approx(empty.scene.placements[name][2, 3] + 0.15, abs=0.01)
    assert held.counts.joint_limit_violations == held.counts.velocity_limit_violations == 0
    assert kinds(empty.events()) == ["grasped"]
    state_of_grippers = empty.gripper_state()
    index = state_of_grippers.arms.index(arm)
    assert state_of_grippers.gripping[index]
    assert state_of_grippers.forces[index] == pytest.approx(15.0, abs=1.0)


def test_weight_of_a_held_object_shows_in_the_efforts(empty):
    pick(empty, "pitcher", "right", "handle")
    empty.run(1.0)
    group = empty.world.arms["right"]
    force = robot().external_force(
        "right", empty.data.qpos[group.positions], empty.data.actuator_force[group.actuators]
    )
    np.testing.assert_allclose(force, [0.0, 0.0, -0.9 * 9.81], atol=2.0)


def test_object_let_go_in_the_air_falls_and_is_reported(empty):
    pick(empty)
    away = home_of("left").copy()
    move(empty, "left", away)
    empty.events()
    empty.command_gripper("left", robot().arm("left").opening[1])
    empty.run(2.0)
    events = empty.events()
    assert kinds(events) == ["released", "dropped"]
    assert events[1].object_name == "mug"
    assert events[1].holder == "robot:left"
    assert "floor" in events[1].message
    assert empty.truth().holders["mug"] == "floor"


def test_object_put_back_on_the_table_is_placed(empty):
    pick(empty, lift=0.02)
    empty.command_gripper("left", robot().arm("left").opening[1])
    empty.run(1.5)
    assert kinds(empty.events())[-2:] == ["released", "placed"]
    assert empty.truth().holders["mug"] == "table"


def test_fingers_that_close_on_air_hold_nothing(empty):
    empty.command_gripper("left", robot().arm("left").opening[0])
    empty.run(1.0)
    assert empty.gripper_state().gripping == (False, False)
    assert empty.events() == []


def test_objects_alone_can_be_reset(empty):
    pick(empty)
    posture = empty.data.qpos[empty.world.arms["left"].positions].copy()
    empty.reset(objects_only=True)
    truth = empty.truth()
    for name, placed in empty.scene.placements.items():
        np.testing.assert_allclose(truth.objects[name], placed, atol=1e-9)
    assert set(truth.holders.values()) == {"table"}
    np.testing.assert_array_equal(empty.data.qpos[empty.world.arms["left"].positions], posture)


def present_mug(simulation):
    """Bring the mug before the person, and wait until the hand pulls."""
    pick(simulation, "mug", "left", "side")
    move(simulation, "left", presentation("mug", "left", "side"))
    for _ in range(80):
        simulation.run(0.1)
        if simulation.truth().holders["mug"].count("person"):
            simulation.run(1.0)
            return
    raise AssertionError(f"the person did not take the mug, it is {simulation.person.phase}")


def test_person_takes_what_is_offered_and_brings_it_to_the_goal(staffed):
    present_mug(staffed)
    both = staffed.truth()
    assert both.holders["mug"].startswith("robot:left+person:")
    staffed.command_gripper("left", robot().arm("left").opening[1])
    staffed.run(0.6)
    assert staffed.truth().holders["mug"].startswith("person:")
    staffed.run(12.0)
    assert staffed.truth().holders["mug"] == "goal"
    assert [kind for kind in kinds(staffed.events()) if kind != "fault"] == [
        "grasped",
        "taken",
        "released",
        "released",
        "placed",
    ]
    np.testing.assert_allclose(staffed.truth().objects["mug"][:3, 3], staffed.scene.goals["mug"][:3, 3], atol=0.04)
    assert staffed.truth().counts.velocity_limit_violations == 0


def test_pull_of_the_person_is_felt_by_the_robot(staffed):
    present_mug(staffed)
    group = staffed.world.arms["left"]
    weight = np.array([0.0, 0.0, -0.3 * 9.81])
    pulls = []
    for _ in range(30):
        staffed.run(0.1)
        efforts = staffed.data.actuator_force[group.actuators]
        pulls.append(robot().external_force("left", staffed.data.qpos[group.positions], efforts) - weight)
    assert np.linalg.norm(pulls, axis=1).max() > 2.0


def test_person_who_ignores_takes_nothing(staffed):
    staffed.set_behaviour("ignore")
    with pytest.raises(AssertionError, match="did not take"):
        present_mug(staffed)


def test_faults_reach_the_motion_capture(staffed):
    staffed.set_fault("occlusion", 1.0, 0.5)
    staffed.run(0.4)
    assert np.isnan(staffed.frames()[-1][1].positions).all()
    staffed.run(0.4)
    assert np.isfinite(staffed.frames()[-1][1].positions).any()
    with pytest.raises(UnknownNameError, match="label_swap"):
        staffed.set_fault("gremlins")
    with pytest.raises(BadRequestError, match="fraction"):
        staffed.set_fault("occlusion", 7.0)


def test_torso_target_is_followed(staffed):
    target = staffed.truth().torso.copy()
    target[:3, 3] += [0.0, 0.15, -0.02]
    staffed.set_torso_target(target)
    staffed.run(3.0)
    assert np.linalg.norm(staffed.truth().torso[:3, 3] - target[:3, 3]) < 0.03


def test_cell_without_a_person_says_so(empty):
    assert empty.truth().torso is None
    for call in (
        lambda: empty.set_behaviour("take"),
        lambda: empty.set_fault("ghost"),
        lambda: empty.set_torso_target(None),
    ):
        with pytest.raises(BadRequestError, match="person"):
            call()


def test_bad_options_are_refused():
    with pytest.raises(BadModelError, match="physics_rate"):
        SimulationOptions(physics_rate=123.0)
    with pytest.raises(BadModelError, match="rate"):
        Simulation(load_scene("lab"), 1, SimulationOptions(mocap_rate=1000.0))
    with pytest.raises(UnknownNameError, match="adult"):
        Simulation(load_scene("lab"), 1, SimulationOptions(person="nobody_known"))


@pytest.mark.parametrize("rate", [400.0, 1000.0])
def test_other_physics_rates_run(rate):
    simulation = Simulation(load_scene("lab"), 1, SimulationOptions(physics_rate=rate, mocap_rate=100.0))
    simulation.run(0.5)
    assert simulation.time == pytest.approx(0.5)
    assert len(simulation.frames()) == pytest.approx(50, abs=1)
