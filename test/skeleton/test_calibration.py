"""Calibration of synthetic people: joints, axes and limits from markers with 1 mm noise, 10 % of them missing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bad_recordings import recording_of
from comparison import compare
from people import calibration_motion, drawer_cabinet, random_person, right_arm_of, sweeps, two_dof_person
from scipy.spatial.transform import Rotation

from handover_ros.errors import BadRequestError
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.skeleton.calibration import CalibrationSettings, calibrate
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.templates import load_template

TORSO_FRAME = load_marker_set("upper_body_24").torso
SEEDS = (0, 2, 3)
CENTRE = 0.005  # [m]
AXIS, LIMIT = np.deg2rad(1.5), np.deg2rad(3.0)


@cache
def person(seed):
    """Return the motion of a two-armed person and their calibration."""
    motion = calibration_motion(random_person(seed), seed=seed)
    return motion, calibrate(recording_of(motion), load_template("upper_body"), TORSO_FRAME)


@pytest.mark.parametrize("seed", SEEDS)
def test_joint_centres_of_two_armed_people(seed):
    motion, calibration = person(seed)
    assert max(compare(motion.skeleton, calibration.skeleton).centres.values()) < CENTRE


@pytest.mark.parametrize("seed", SEEDS)
def test_axes_of_elbows_and_forearms(seed):
    """Those of the wrist, where two markers on a hand show two axes, are only as good as the report says."""
    motion, calibration = person(seed)
    axes = compare(motion.skeleton, calibration.skeleton).axes
    assert max(axes[f"{side}_{joint}"] for side in ("left", "right") for joint in ("elbow", "forearm")) < AXIS
    said = {joint.name: joint.axis_error for joint in calibration.report.joints}
    for name, error in axes.items():
        assert error < max(AXIS, 5.0 * said[name]), name


@pytest.mark.parametrize("seed", SEEDS)
def test_limits_of_two_armed_people(seed):
    motion, calibration = person(seed)
    found = compare(motion.skeleton, calibration.skeleton)
    for name in found.lower:
        assert abs(found.lower[name]) < LIMIT, name
        assert abs(found.upper[name]) < LIMIT, name


@pytest.mark.parametrize("seed", SEEDS)
def test_report_of_a_clean_calibration(seed):
    """No problem, nothing to do better; errors of the size of the noise, whose mean distance in space is 1.6 sigma."""
    motion, calibration = person(seed)
    report = calibration.report
    assert report.usable
    assert report.problems == ()
    assert not [line for line in report.advice if "moved" in line]
    assert report.heldout_frames > 200
    assert report.frames > 1000
    assert report.missing_fraction == pytest.approx(np.isnan(motion.measured[..., 0]).mean())
    assert 0.0012 < report.fit_rms < 0.0018
    assert {marker.name for marker in report.markers} == set(motion.skeleton.marker_names)
    assert max(marker.fitted_rms for marker in report.markers) < 0.0025
    names = calibration.skeleton.displacement_names
    assert tuple(joint.displacement for joint in report.joints) == names
    for index, joint in enumerate(report.joints):
        assert joint.moved == pytest.approx(joint.upper - joint.lower)
        assert joint.lower == calibration.skeleton.lower[index]


def test_standing_still_is_the_zero_posture():
    """The limits enclose zero, and in the first frames every displacement is small."""
    motion, calibration = person(0)
    skeleton = calibration.skeleton
    assert (skeleton.lower < 0.0).all()
    assert (skeleton.upper > 0.0).all()
    postures, _ = solve_postures(skeleton.tree, skeleton.zero, motion.measured[:40])
    assert np.abs(np.median(skeleton.displacements(postures, np.zeros(14)), axis=0)).max() < np.deg2rad(5.0)


def test_left_out_frames_fit_as_well_as_fitted_ones():
    """Mean distances of both kinds, marker by marker and over all, by the frames' own best postures."""
    _, calibration = person(3)
    report = calibration.report
    assert report.heldout_frames > 200
    assert report.frames + report.heldout_frames <= 1500
    fitted = report.fit_rms * np.sqrt(8.0 / (3.0 * np.pi))  # mean over root mean square of a Gaussian in space
    assert abs(report.heldout_mean / fitted - 1.0) < 0.1


def test_no_frames_need_be_left_out():
    recording = recording_of(sweeps(two_dof_person(4), frames=300))
    report = calibrate(recording, load_template("two_dof_arm"), settings=CalibrationSettings(holdout=0.0)).report
    assert report.frames > 270  # those that show three markers of the root
    assert report.heldout_frames == 0
    assert np.isnan(report.heldout_mean)
    assert report.usable


# Other trees.


@pytest.mark.parametrize("seed", range(3))
def test_the_arm_of_two_degrees_of_freedom(seed):
    """Figure 2.4 of the dissertation."""
    truth = two_dof_person(seed)
    calibration = calibrate(recording_of(sweeps(truth, seed=seed)), load_template("two_dof_arm"))
    found = compare(truth, calibration.skeleton)
    assert max(found.centres.values()) < CENTRE
    assert max(found.axes.values()) < AXIS
    assert max(np.abs([*found.lower.values(), *found.upper.values()])) < LIMIT
    assert calibration.report.usable


@pytest.mark.parametrize("seed", range(3))
def test_a_cabinet_with_a_drawer_and_a_flap(seed):
    """An articulated object fixed in the room: a prismatic and a revolute joint on the world."""
    truth = drawer_cabinet(seed)
    calibration = calibrate(recording_of(sweeps(truth, seed=seed)), load_template("drawer_cabinet"))
    found = compare(truth, calibration.skeleton)
    assert found.centres["hinge"] < CENTRE
    assert max(found.axes.values()) < AXIS
    for limits in (found.lower, found.upper):
        assert abs(limits["drawer_extension"]) < 0.005
        assert abs(limits["flap_opening"]) < LIMIT
    assert calibration.report.usable


def test_a_single_arm():
    seed = 1
    truth = right_arm_of(random_person(seed))
    motion = calibration_motion(truth, seed=seed)
    calibration = calibrate(recording_of(motion), load_template("right_arm"), TORSO_FRAME)
    found = compare(truth, calibration.skeleton)
    assert max(found.centres.values()) < CENTRE
    assert max(found.axes["right_elbow"], found.axes["right_forearm"]) < AXIS
    assert max(np.abs([*found.lower.values(), *found.upper.values()])) < LIMIT


# How it runs.


@pytest.fixture(scope="module")
def arm():
    motion = sweeps(two_dof_person(0), frames=300)
    return recording_of(motion)


def test_the_same_seed_gives_the_same_skeleton(arm):
    template = load_template("two_dof_arm")
    first, second = (calibrate(arm, template, settings=CalibrationSettings(seed=3)) for _ in range(2))
    np.testing.assert_array_equal(first.skeleton.tree.axis, second.skeleton.tree.axis)
    np.testing.assert_array_equal(first.skeleton.markers, second.skeleton.markers)
    np.testing.assert_array_equal(first.skeleton.lower, second.skeleton.lower)
    assert replace(first.report, seconds=0.0) == replace(second.report, seconds=0.0)


def test_another_seed_finds_the_same_minimum(arm):
    template = load_template("two_dof_arm")
    first, second = (calibrate(arm, template, settings=CalibrationSettings(seed=seed)) for seed in (3, 4))
    np.testing.assert_allclose(first.skeleton.tree.axis, second.skeleton.tree.axis, atol=1e-3)
    np.testing.assert_allclose(first.skeleton.markers, second.skeleton.markers, atol=1e-3)


def test_progress_grows_to_nearly_one_and_tells_the_error(arm):
    steps = []
    calibrate(arm, load_template("two_dof_arm"), progress=lambda share, rms: steps.append((share, rms)))
    shares = [share for share, _ in steps]
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < 0.5 < shares[-1] <= 1.0
    assert 0.001 < steps[-1][1] < 0.002


def test_where_the_person_stands_does_not_matter(arm):
    """In a room whose origin is ten metres away, facing 30 degrees to the left."""
    turn = Rotation.from_euler("z", 30.0, degrees=True).as_matrix()
    template = load_template("two_dof_arm")
    here = calibrate(arm, template)
    there = calibrate(replace(arm, positions=arm.positions @ turn.T + [10.0, -4.0, 0.0]), template)
    assert there.report.fit_rms == pytest.approx(here.report.fit_rms, rel=1e-3)
    np.testing.assert_allclose(there.skeleton.lower, here.skeleton.lower, atol=np.deg2rad(0.5))
    zero = forward(here.skeleton.tree, here.skeleton.zero), forward(there.skeleton.tree, there.skeleton.zero)
    lengths = [np.linalg.norm(each[:, None] - each[None], axis=2) for each in zero]
    np.testing.assert_allclose(lengths[0], lengths[1], atol=5e-4)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"max_frames": 10}, "max_frames: must lie within 60 to 20000, got 10"),
        ({"holdout": 0.9}, "holdout: must lie within 0 to 0.5, got 0.9"),
    ],
)
def test_settings_out_of_range_are_refused(settings, words):
    with pytest.raises(BadRequestError, match=words):
        CalibrationSettings(**settings)
