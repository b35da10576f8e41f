"""A skeleton as URDF."""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_trees import pinocchio_posture, random_skeleton

from handover_ros.errors import BadModelError, UnknownNameError
from handover_ros.skeleton.reference import segment_pose
from handover_ros.skeleton.tree import WORLD, Joint, JointKind, Skeleton
from handover_ros.skeleton.urdf import UNKNOWN_ANGLE, SegmentInertia, skeleton_urdf


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_pinocchio_places_every_segment_where_the_skeleton_does(seed, free):
    skeleton = random_skeleton(seed, free=free)
    theta = np.random.default_rng(seed).uniform(-2.0, 2.0, len(skeleton.displacement_names))
    model = pinocchio.buildModelFromXML(skeleton_urdf(skeleton))
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, pinocchio_posture(model, skeleton, theta))
    for joint in skeleton.joints:
        frame = data.oMf[model.getFrameId(joint.segment, pinocchio.FrameType.BODY)]
        expected = segment_pose(skeleton, theta, joint.segment)
        expected[:3, 3] += expected[:3, :3] @ joint.point
        np.testing.assert_allclose(frame.homogeneous, expected, atol=1e-9)


def test_one_link_a_segment_and_one_joint_a_displacement():
    skeleton = random_skeleton(3)
    robot = ElementTree.fromstring(skeleton_urdf(skeleton, name="somebody"))
    assert robot.attrib["name"] == "somebody"
    assert [joint.attrib["name"] for joint in robot.findall("joint")] == list(skeleton.displacement_names)
    links = {link.attrib["name"] for link in robot.findall("link")}
    assert {joint.segment for joint in skeleton.joints} <= links
    spheres = [s for s in robot.iter("sphere") if float(s.attrib["radius"]) == 0.007]
    assert len(spheres) == len(skeleton.marker_names)


def test_limits_are_the_persons_and_unknown_ones_wide():
    skeleton = random_skeleton(3)
    lower = np.full_like(skeleton.lower, -0.3)
    lower[0] = -np.inf
    robot = ElementTree.fromstring(skeleton_urdf(skeleton.with_limits(lower, skeleton.upper)))
    limits = [joint.find("limit").attrib for joint in robot.findall("joint")]
    assert float(limits[0]["lower"]) in (-UNKNOWN_ANGLE, -10.0)
    assert all(float(limit["lower"]) == -0.3 for limit in limits[1:])
    assert all(float(limit["upper"]) == 2.0 for limit in limits)


def test_inertias_arrive_in_the_zero_frame():
    skeleton = random_skeleton(5, free=False)
    centre, tensor = np.array([0.3, -0.2, 0.1]), np.diag([0.02, 0.03, 0.04])
    tensor[0, 1] = tensor[1, 0] = 0.004
    segment = skeleton.joints[-1].segment
    model = pinocchio.buildModelFromXML(skeleton_urdf(skeleton, {segment: SegmentInertia(2.5, centre, tensor)}))
    inertia = model.inertias[model.getJointId(skeleton.displacement_names[-1])]
    assert inertia.mass == pytest.approx(2.5)
    np.testing.assert_allclose(inertia.lever, centre - skeleton.joints[-1].point, atol=1e-12)
    np.testing.assert_allclose(inertia.inertia, tensor, atol=1e-12)


def test_inertia_of_an_unknown_segment_is_refused():
    with pytest.raises(UnknownNameError, match="tail"):
        skeleton_urdf(random_skeleton(1), {"tail": SegmentInertia(1.0, np.zeros(3), np.eye(3))})


def test_two_links_of_one_name_are_refused():
    ball = Joint("hip", JointKind.BALL, WORLD, "thigh", ("a", "b", "c"), np.eye(3), np.zeros(3))
    hinge = Joint("knee", JointKind.REVOLUTE, "thigh", "a_link", ("d",), np.eye(3)[:1], np.zeros(3))
    skeleton = Skeleton("leg", (ball, hinge), (), (), np.zeros((0, 3)), np.zeros(4), np.ones(4))
    with pytest.raises(BadModelError, match="a_link"):
        skeleton_urdf(skeleton)
    assert skeleton_urdf(replace(skeleton, joints=(ball,), lower=np.zeros(3), upper=np.ones(3)))
