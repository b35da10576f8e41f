"""Templates: every file loads, a typo is one line, and the right one is found for a marker set."""

import numpy as np
import pytest
import yaml

from handover_ros.errors import BadModelError, BadRecordingError, ErrorCode, UnknownNameError
from handover_ros.mocap.marker_sets import load_marker_set
from handover_ros.resources import config_file, config_names
from handover_ros.skeleton.templates import blank_skeleton, load_template, matching_template
from handover_ros.skeleton.tree import WORLD, JointKind

NAMES = config_names("skeletons")


def segments_of(marker_set):
    return tuple(marker.segment for marker in load_marker_set(marker_set).content.markers)


@pytest.mark.parametrize("name", NAMES)
def test_every_template_makes_a_skeleton(name):
    """With three markers on every segment; the tree follows the file, joint by joint."""
    template = load_template(name)
    content = template.content
    segments = tuple(segment for segment in content.segments if segment != WORLD for _ in range(3))
    skeleton = blank_skeleton(template, tuple(f"M{i}" for i in range(len(segments))), segments)
    assert skeleton.name == name
    assert skeleton.root == content.root
    assert skeleton.is_free == (content.root != WORLD)
    for joint in content.joints:
        made = skeleton.joint(joint.name)
        assert made.displacement_names == joint.displacements
        np.testing.assert_allclose(made.axes, joint.directions)
    assert np.isinf(skeleton.lower).all()
    assert np.isinf(skeleton.upper).all()
    assert {segment for _, segment in skeleton.hands} <= set(content.segments)


def test_the_upper_body_has_two_arms_of_seven():
    """Three of the shoulder, elbow, forearm, two of the wrist; every arm ends in a hand that takes objects."""
    template = load_template("upper_body").content
    for side in ("left", "right"):
        names = [name for joint in template.joints if joint.side == side for name in joint.displacements]
        assert len(names) == 7
        assert template.hands[side] == f"{side}_hand"


def test_left_and_right_mirror_each_other():
    """Positive is the same motion on both sides: mirrored at y = 0 a rotation's direction keeps y and turns x and z."""
    joints = {joint.name: joint for joint in load_template("upper_body").content.joints}
    for name, right in joints.items():
        if right.side == "right":
            left = joints[name.replace("right", "left")]
            np.testing.assert_allclose(left.directions, right.directions * [-1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("marker_set", "template"),
    [
        ("upper_body_24", "upper_body"),
        ("ue_adl", "right_arm_on_shoulder"),
        ("pyomeca_daphnee", "right_arm_with_scapula"),
    ],
)
def test_the_right_template_for_the_marker_sets(marker_set, template):
    found = matching_template(segments_of(marker_set))
    assert found is not None
    other = template.replace("right", "left")
    assert found.name == template or (marker_set == "ue_adl" and found.name == other)


def test_a_template_that_uses_more_markers_wins_and_the_smaller_of_equals():
    torso = ("torso",) * 4
    arm = ("right_upper_arm", "right_forearm", "right_hand")
    assert matching_template((*torso, *arm)).name == "right_arm"
    assert matching_template((*torso, *arm[:2])).name == "two_dof_arm"
    both = (*arm, *(name.replace("right", "left") for name in arm))
    assert matching_template((*torso, *both)).name == "upper_body"


def test_no_template_for_what_cannot_be_fitted():
    assert matching_template(()) is None
    assert matching_template(("torso", "torso", "right_hand")) is None
    assert matching_template(("object/mug",) * 6) is None


# Mistakes in files.


def changed(edit):
    """Return the text of the two-degree arm after ``edit`` of its content."""
    content = yaml.safe_load(config_file("skeletons", "two_dof_arm").read_text())
    edit(content)
    return yaml.safe_dump(content)


def joint(content, index=1):
    return content["joints"][index]


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda c: c.update(rot="torso"), "rot: "),
        (lambda c: c.pop("root"), "root: "),
        (lambda c: c.update(joints=[]), "joints: "),
        (lambda c: joint(c).update(kind="hinge"), "joints.1.kind: "),
        (lambda c: joint(c).update(parrent="torso"), "joints.1.parrent: "),
        (lambda c: joint(c).pop("segment"), "joints.1.segment: "),
        (lambda c: joint(c).update(parent="right_shin"), "joints.right_elbow.parent: 'right_shin'"),
        (lambda c: joint(c).update(segment="torso"), "joints.right_elbow.segment: 'torso' is carried twice"),
        (lambda c: joint(c).update(name="right_shoulder"), "'right_shoulder' appears twice"),
        (lambda c: joint(c).update(displacements=["right_shoulder_flexion"]), "appears twice"),
        (lambda c: joint(c).update(displacements=["a", "b"]), "a revolute joint has 1, got 2"),
        (lambda c: joint(c).update(positive=[[0, 0, 0]]), "must not be zero"),
        (lambda c: joint(c).update(positive=[[0, 1]]), "joints.1.positive.0.2: "),
        (lambda c: joint(c).update(positive=[[0, 1, 0], [1, 0, 0]]), "one direction for each"),
        (lambda c: joint(c).update(meets="right_wrist"), "joints.right_elbow.meets: 'right_wrist'"),
        (lambda c: joint(c).update(side="top"), "joints.1.side: "),
        (lambda c: joint(c).update(name="1 elbow"), "joints.1.name: "),
        (lambda c: c.update(hands={"right": "right_foot"}), "hands.right: 'right_foot' is carried by no joint"),
        (
            lambda c: joint(c).update(
                kind="ball", displacements=["a", "b", "c"], positive=[[1, 0, 0], [1, 0, 0], [0, 0, 1]]
            ),
            "right angles",
        ),
    ],
)
def test_a_mistake_is_one_line_naming_file_and_field(tmp_path, edit, words):
    path = tmp_path / "my_arm.yaml"
    path.write_text(changed(lambda content: None))
    assert load_template(str(path)).name == "my_arm"
    path.write_text(changed(edit))
    with pytest.raises(BadModelError) as caught:
        load_template(str(path))
    message = str(caught.value)
    assert str(path) in message
    assert words in message
    assert "\n" not in message


def test_an_unknown_template_lists_the_known_ones():
    with pytest.raises(UnknownNameError) as caught:
        load_template("upper_bdoy")
    assert all(name in str(caught.value) for name in NAMES)


# Markers that do not suffice.


@pytest.mark.parametrize(
    ("segments", "words"),
    [
        (("torso", "torso", "right_upper_arm", "right_forearm", "right_hand"), "at least 3 markers on segment 'torso'"),
        (("torso",) * 4 + ("right_upper_arm", "right_forearm"), "no marker on segment 'right_hand'"),
    ],
)
def test_too_few_markers_are_refused_with_a_remedy(segments, words):
    names = tuple(f"M{i}" for i in range(len(segments)))
    with pytest.raises(BadRecordingError, match=words) as caught:
        blank_skeleton(load_template("right_arm"), names, segments)
    assert caught.value.code == ErrorCode.NOT_ENOUGH_DATA
    assert "add markers" in str(caught.value)


def test_markers_of_other_segments_are_left_out():
    segments = ("object/mug", *["torso"] * 3, "right_forearm", "left_hand", "right_upper_arm")
    skeleton = blank_skeleton(load_template("two_dof_arm"), tuple("ABCDEFG"), segments)
    assert skeleton.marker_names == ("B", "C", "D", "E", "G")
    assert skeleton.joints[0].kind is JointKind.FREE
