"""Standard errors: as large as the scatter of many fits to fresh noise."""

import numpy as np
import pytest
from people import random_person
from problems import chain
from random_trees import random_pose

from handover_ros.skeleton.certainty import displacement_covariance, posture_deviations, standard_errors
from handover_ros.skeleton.gauge import gauge_directions
from handover_ros.skeleton.kernels import forward
from handover_ros.skeleton.layout import parameter_layout
from handover_ros.skeleton.postures import solve_postures
from handover_ros.skeleton.prediction_error import FitSettings, minimise
from handover_ros.skeleton.tree import Joint, JointKind, Skeleton

NOISE = 0.001
FITS = 60
LIKE = 1.4  # the factor within which an error and a scatter of FITS fits must agree


def small_problem():
    """Return a skeleton of a free base and three joints, and postures of thirty frames."""
    rng = np.random.default_rng(4)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.02, -0.3], [0.02, 0.0, -0.55]])
    serial = chain(axes, points, points[:, None] + rng.uniform(-0.12, 0.12, (3, 4, 3)))
    base = Joint("base_root", JointKind.FREE, "world", "base", (), np.zeros((0, 3)), np.zeros(3))
    joints = (base, Joint("joint0", JointKind.REVOLUTE, "base", "link0", ("angle0",), axes[:1], points[0]))
    skeleton = Skeleton(
        "small",
        joints + serial.joints[1:],
        ("b0", "b1", "b2", "b3", *serial.marker_names),
        ("base",) * 4 + serial.marker_segments,
        np.vstack([rng.uniform(-0.15, 0.15, (4, 3)), serial.markers]),
        serial.lower,
        serial.upper,
    )
    theta = rng.uniform(-0.6, 0.6, (30, 3))
    theta[:, 1] *= 0.4  # moved less, so known less
    theta[0] = 0.0
    return skeleton, skeleton.coordinates(theta, np.array([random_pose(rng) for _ in range(30)]))


@pytest.fixture(scope="module")
def scatter():
    """Fit fresh noise again and again; return errors said and scatter seen, of axes [rad] and points [m]."""
    rng = np.random.default_rng(0)
    skeleton, coordinates = small_problem()
    tree, layout = skeleton.tree, parameter_layout(skeleton.tree)
    directions = gauge_directions(tree, layout)
    columns = layout.marker_column[:, None] + np.arange(3)
    datum = np.linalg.pinv(directions[columns.ravel()])
    hidden = rng.random((len(coordinates), len(skeleton.marker_names))) < 0.1
    changes, said = [], []
    for _ in range(FITS):
        observed = forward(tree, coordinates) + NOISE * rng.normal(size=(len(coordinates), len(tree.marker), 3))
        observed[hidden] = np.nan
        fit = minimise(tree, layout, coordinates, observed, FitSettings(tolerance=1e-9), frozen=0)
        change = np.zeros(layout.count)
        for j in range(len(tree.kind)):
            if (column := layout.axis_column[j]) >= 0:
                change[column : column + 2] = layout.axis_basis[j].T @ (fit.tree.axis[j] - tree.axis[j])
            if (column := layout.point_column[j]) >= 0:
                change[column : column + 2] = layout.point_basis[j, :, :2].T @ (fit.tree.point[j] - tree.point[j])
        change[columns] = fit.tree.marker - tree.marker
        changes.append(change - directions @ (datum @ change[columns.ravel()]))
        said.append(standard_errors(fit.tree, layout, fit.coordinates, observed, NOISE))
    covariance = np.cov(np.array(changes).T)
    seen = []
    for j in range(1, len(tree.kind)):
        axis, point = layout.axis_column[j], layout.point_column[j]
        seen.append(
            (
                np.sqrt(np.linalg.eigvalsh(covariance[axis : axis + 2, axis : axis + 2])[-1]),
                np.sqrt(np.trace(covariance[point : point + 2, point : point + 2])),
            )
        )
    return np.median(said, axis=0).T[1:], np.array(seen)


def test_errors_of_axes_and_points_agree_with_the_scatter_of_fits(scatter):
    said, seen = scatter
    assert (said > 0.0).all()
    ratio = said / seen
    assert ratio.max() < LIKE, ratio
    assert ratio.min() > 1.0 / LIKE, ratio


def test_a_joint_that_moved_less_is_less_certain(scatter):
    said, _ = scatter
    assert said[1, 0] > 1.5 * max(said[0, 0], 0.0)


def test_errors_grow_with_the_noise_and_a_motionless_joint_is_unknown():
    skeleton, coordinates = small_problem()
    layout = parameter_layout(skeleton.tree)
    observed = forward(skeleton.tree, coordinates)
    once = standard_errors(skeleton.tree, layout, coordinates, observed, NOISE)
    twice = standard_errors(skeleton.tree, layout, coordinates, observed, 2.0 * NOISE)
    np.testing.assert_allclose(twice, 2.0 * np.array(once))
    still = coordinates.copy()
    still[:, 7 + 1] = 0.0
    axis, _ = standard_errors(skeleton.tree, layout, still, forward(skeleton.tree, still), NOISE)
    assert np.degrees(axis[2]) > 5.0
    assert np.degrees(axis[[1, 3]]).max() < 2.0


def test_deviations_of_postures_agree_with_the_scatter_of_noisy_frames():
    """A person of 24 markers, some of them hidden, in one posture, seen 300 times."""
    rng = np.random.default_rng(1)
    person = random_person(1)
    theta = 0.5 * (person.lower + person.upper) + 0.1
    q = person.coordinates(theta, random_pose(rng))
    hidden = rng.random(len(person.marker_names)) < 0.15
    observed = forward(person.tree, q) + NOISE * rng.normal(size=(300, len(hidden), 3))
    observed[:, hidden] = np.nan
    found, _ = solve_postures(person.tree, q, observed)
    scatter = person.displacements(found, near=theta).std(axis=0)
    said = NOISE * posture_deviations(person, q[None], observed[:1])[0]
    np.testing.assert_allclose(said / scatter, 1.0, atol=0.2)


def test_a_displacement_that_no_marker_shows_is_very_uncertain():
    person = random_person(2)
    q = person.coordinates(0.2 * np.ones(14), np.eye(4))
    observed = forward(person.tree, q)[None].copy()
    observed[0, [name.startswith("RARM") and name[-1] in "78" for name in person.marker_names]] = np.nan
    deviations = posture_deviations(person, q[None], observed)[0]
    hand = [name.startswith("right_wrist") for name in person.displacement_names]
    assert deviations[hand].min() > 100.0 * deviations[np.logical_not(hand)].max()


def test_covariance_of_a_ball_is_carried_to_its_angles():
    """At zero the rotation vector and the three angles are the same, whatever order the axes have."""
    axes = np.eye(3)[[2, 0, 1]]
    ball = Joint("b", JointKind.BALL, "world", "s", ("x", "y", "z"), axes, np.zeros(3))
    skeleton = Skeleton("b", (ball,), (), (), np.zeros((0, 3)), np.full(3, -1.0), np.full(3, 1.0))
    covariance = np.diag([1.0, 4.0, 9.0])
    result = displacement_covariance(skeleton, np.zeros(3), covariance)
    np.testing.assert_allclose(result, np.diag([9.0, 1.0, 4.0]), atol=1e-9)
