"""The MuJoCo model of the cell agrees with what it was built from."""

import mujoco
import numpy as np
import pytest
from cell import empty_cell, robot, staffed_cell
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadModelError
from handover_ros.objects.catalogue import load_catalogue
from handover_ros.objects.scene import load_scene
from handover_ros.sim.robot_body import OBJECT_BIT
from handover_ros.sim.urdf_shapes import link_shapes
from handover_ros.sim.world import build_world


@given(seed=st.integers(0, 10_000), arm=st.sampled_from(["left", "right"]))
@settings(deadline=None, max_examples=25)
def test_gripper_site_is_where_the_kinematic_model_says(seed, arm):
    world = empty_cell().world
    model = robot().arm(arm)
    displacements = np.random.default_rng(seed).uniform(model.lower, model.upper)
    data = mujoco.MjData(world.model)
    data.qpos[world.arms[arm].positions] = displacements
    mujoco.mj_kinematics(world.model, data)
    site, expected = data.site(f"robot/{arm}_gripper"), robot().gripper_pose(arm, displacements)
    np.testing.assert_allclose(site.xpos, expected[:3, 3], atol=1e-9)
    np.testing.assert_allclose(site.xmat.reshape(3, 3), expected[:3, :3], atol=1e-9)


def test_joint_and_effort_limits_are_the_urdfs():
    world = empty_cell().world
    for name in robot().arm_names:
        arm, group = robot().arm(name), world.arms[name]
        joints = [world.model.joint(f"robot/{joint}").id for joint in arm.joint_names]
        np.testing.assert_allclose(world.model.jnt_range[joints], np.column_stack([arm.lower, arm.upper]))
        np.testing.assert_allclose(world.model.actuator_forcerange[group.actuators, 1], arm.effort)


def test_objects_have_their_mass_and_rest_where_they_were_placed():
    """After two seconds of physics nothing fell over, rolled away or was pushed out of a table."""
    simulation = empty_cell()
    simulation.reset(seed=1)
    simulation.run(2.0)
    catalogue = load_catalogue()
    for name, placed in simulation.scene.placements.items():
        body = simulation.world.object_bodies[name]
        assert simulation.model.body_mass[body] == pytest.approx(catalogue[name].mass, rel=1e-6)
        np.testing.assert_allclose(simulation.data.xpos[body], placed[:3, 3], atol=0.002)
        np.testing.assert_allclose(simulation.data.xmat[body].reshape(3, 3), placed[:3, :3], atol=0.02)


def test_nothing_touches_at_the_start_but_objects_and_tables():
    simulation = staffed_cell()
    simulation.reset(seed=1)
    for contact in simulation.data.contact:
        bits = {int(simulation.model.geom_contype[geom]) for geom in contact.geom}
        assert OBJECT_BIT in bits


def test_what_is_drawn_does_not_collide():
    model = empty_cell().model
    drawn = model.geom_group == 1
    assert drawn.sum() > 20
    assert not model.geom_contype[drawn].any()


@pytest.mark.parametrize("timestep", [0.0, -0.001, 0.02, float("nan")])
def test_time_step_out_of_range_is_refused(timestep):
    with pytest.raises(BadModelError, match="time step"):
        build_world(load_scene("lab"), robot(), load_catalogue(), None, timestep)


@pytest.mark.parametrize(
    "body",
    [
        "<robot><link name='a'><visual><geometry/></visual></link></robot>",
        "<robot><link name='a'><visual><geometry><box size='1 x 3'/></geometry></visual></link></robot>",
        "<robot><link name='a'><visual><geometry><cone/></geometry></visual></link></robot>",
        "<robot>",
    ],
)
def test_bad_urdf_is_named(tmp_path, body):
    path = tmp_path / "robot.urdf"
    path.write_text(body)
    with pytest.raises(BadModelError, match=r"robot\.urdf"):
        link_shapes(path, tmp_path)
