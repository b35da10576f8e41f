"""What the benchmark measures with: the peer's model is ours, motions are within reach, verdicts say what is true."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench import planning
from bench.__main__ import verdict
from bench.arm import MOTIONS, RATE, error_deg, person, record
from bench.biorbd_peer import model_text
from bench.fuzz_planning import PATIENCE, fuzz
from bench.inverse_kinematics import costs_of, hand_poses, least_cost, offsets
from bench.peers import PEERS
from handover_ros.arm.model import AXES, load_arm
from handover_ros.skeleton.kernels import forward

SOURCE = Path(__file__).resolve().parent.parent


def blocks(text, kind):
    """Return the fields of every segment or marker of a bioMod file, by name."""
    found, name = {}, ""
    lines = iter(text.splitlines())
    for line in lines:
        key, _, value = line.partition(" ")
        if key == kind:
            name, found[value] = value, {}
        elif key == f"end{kind}":
            name = ""
        elif name and key == "rt":
            found[name]["rt"] = np.array([next(lines).split() for _ in range(4)], dtype=float)
        elif name:
            found[name][key] = value
    return found


def test_the_peers_model_has_the_markers_of_ours():
    """Segments turn about the z axis of their own frames, as the file says, down the chain."""
    skeleton = person(3)
    text = model_text(skeleton)
    displacements = 0.5 * (skeleton.lower + skeleton.upper) + 0.3 * np.random.default_rng(0).normal(size=10)
    poses = {"root": np.eye(4)}
    for (name, segment), angle in zip(blocks(text, "segment").items(), displacements):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
        assert segment["rotations"] == "z"
        poses[name] = poses[segment["parent"]] @ segment["rt"] @ turn
    markers = [
        poses[marker["parent"]] @ [*map(float, marker["position"].split()), 1.0]
        for marker in blocks(text, "marker").values()
    ]
    expected = forward(skeleton.tree, skeleton.coordinates(displacements))
    np.testing.assert_allclose(np.array(markers)[:, :3], expected, atol=1e-12)


@pytest.mark.parametrize("kind", MOTIONS)
def test_motions_are_a_persons(kind):
    """Within the limits, smooth, of a human's speed; the same for the same seed."""
    skeleton = person()
    motion = record(skeleton, kind, 800, 5, missing=0.1)
    assert (motion.displacements > skeleton.lower).all()
    assert (motion.displacements < skeleton.upper).all()
    speed = np.abs(np.diff(motion.displacements, axis=0)) * RATE
    assert 1.0 < speed.max() < 7.0
    assert 0.08 < np.isnan(motion.markers[:, :, 0]).mean() < 0.12
    np.testing.assert_array_equal(record(skeleton, kind, 800, 5, missing=0.1).markers, motion.markers)
    assert error_deg(motion.displacements + math.radians(2.0), motion) == pytest.approx(2.0)
    assert error_deg(motion.displacements + 2.0 * math.pi, motion) == pytest.approx(0.0, abs=1e-9)


def test_verdicts():
    metrics = {"calibration_s": 1.0, "ukf_rmse_deg": 0.3, "biorbd_rmse_deg": 0.25, "ukf_speed_over_biorbd": math.nan}
    assert verdict("calibration_s", metrics) == ("<= 2", "[green]yes[/green]")
    assert verdict("ukf_rmse_deg", metrics) == ("<= 0.25", "[red]no[/red]")
    assert verdict("ukf_speed_over_biorbd", metrics) == (">= 1", "")
    assert verdict("biorbd_rmse_deg", metrics) == ("", "")
    assert verdict("ukf_rmse_deg", {"ukf_rmse_deg": 0.3, "biorbd_rmse_deg": math.nan}) == ("", "")


def test_an_unknown_part_is_refused_in_one_line():
    command = [sys.executable, "-m", "bench", "weather"]
    answer = subprocess.run(command, cwd=SOURCE, capture_output=True, text=True, env=os.environ, check=False)
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1
    assert "weather" in answer.stderr
    assert "tracking" in answer.stderr


def test_the_peers_arm_is_ours():
    """A product of exponentials of our axes with the offsets between them gives the hand's segment."""
    arm = load_arm("adult")
    q = np.random.default_rng(1).uniform(*arm.limits)
    pose, between = np.eye(4), offsets(arm)
    for offset, axis, angle in zip(between, AXES, q):
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_rotvec(angle * axis).as_matrix(), offset
        pose = pose @ step
    pose[:3, 3] += pose[:3, :3] @ between[7]
    np.testing.assert_allclose(pose, arm.segment_poses(arm.hand_pose(q))[0], atol=1e-12)


def test_a_peers_postures_count_only_at_the_pose_and_within_the_limits():
    arm = load_arm("adult")
    q = 0.5 * (arm.limits[0] + arm.limits[1])
    pose = arm.hand_pose(q)
    turned = q + [2.0 * math.pi, 0.0, 0.0, 0.0, 0.0, 0.0, -2.0 * math.pi]
    assert least_cost(arm, pose, turned[None]) == pytest.approx(costs_of(q))
    assert math.isinf(least_cost(arm, pose, q[None] + 0.01))
    assert math.isinf(least_cost(arm, arm.hand_pose(arm.limits[1] + 0.1), arm.limits[1:] + 0.1))


def test_random_hand_poses_are_in_the_reach():
    arm = load_arm("adult")
    for poses in hand_poses(arm, 200, 3):
        wrists = arm.segment_poses(poses)[:, :3, 3]
        assert (np.linalg.norm(wrists - arm.right_shoulder, axis=1) <= arm.upper_arm + arm.forearm + 1e-12).all()


def test_peers_are_pinned_as_in_the_extra():
    text = (SOURCE / "setup.py").read_text(encoding="utf-8")
    for wanted in PEERS.values():
        assert all(f'"{requirement}"' in text and "==" in requirement for requirement in wanted.requirements)


def test_fuzzed_planning_requests_are_all_answered():
    """Unknown names, NaN poses, goals out of reach, budgets of nothing: a sound plan or an error with words."""
    report = fuzz(60, seed=3)
    assert report.plans + sum(report.refusals.values()) == 60
    assert report.crashes == []
    assert report.not_finite == []
    assert report.late < PATIENCE


def test_expected_cost_is_least_then_the_mean_then_the_number_of_postures():
    """The order of Bestick 2017, section 3.5, on average over objects and goals."""
    found = planning.study(seed=2, goals=2)
    assert 1.0 < found["study_minimum_mean_over_expected"] < found["study_maximum_feasibility_over_expected"]
