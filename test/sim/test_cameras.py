"""Motion capture: noise, visibility, clock, faults."""

from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from person_cell import WORLD_FROM_FEET

from handover_ros.errors import BadModelError
from handover_ros.sim.cameras import MocapCamera, MotionCapture, ring_of_cameras
from handover_ros.sim.person_model import PREFIX, add_person
from handover_ros.sim.person_spec import JOINTS, MARKERS, load_person

SITES = [f"{PREFIX}marker/{label}" for label in MARKERS]
CAMERAS = ring_of_cameras()


@cache
def scene(with_wall: bool = False):
    spec = mujoco.MjSpec()
    if with_wall:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=[0.9, 0, 1.0], size=[0.02, 2, 2], group=3)
    add_person(spec, load_person("adult"), WORLD_FROM_FEET)
    model = spec.compile()
    data = mujoco.MjData(model)
    return model, data


def pose(seed: int, with_wall: bool = False):
    model, data = scene(with_wall)
    person = load_person("adult")
    values = np.random.default_rng(seed).uniform(person.lower, person.upper)
    for name, value in zip(JOINTS, values, strict=True):
        data.joint(PREFIX + name).qpos = value
    mujoco.mj_forward(model, data)
    return model, data


def truth(model, data) -> np.ndarray:
    return np.array([data.site(site).xpos for site in SITES])


def test_noise_is_white_with_the_wanted_deviation():
    model, data = pose(0)
    mocap = MotionCapture(model, SITES, CAMERAS, noise=0.001, seed=1)
    error = np.array([mocap.capture(data, k / 240).positions for k in range(1500)]) - truth(model, data)
    seen = np.isfinite(error).all(axis=(0, 2))
    assert seen.sum() > 12
    error = error[:, seen]
    assert abs(error.std() - 0.001) < 2e-5
    assert np.abs(error.mean(axis=0)).max() < 1.5e-4
    correlation = (error[1:] * error[:-1]).mean() / error.var()
    assert abs(correlation) < 0.02


def test_without_noise_a_measured_marker_is_where_it_is():
    model, data = pose(1)
    frame = MotionCapture(model, SITES, CAMERAS, noise=0.0).capture(data, 0.0)
    seen = np.isfinite(frame.positions).all(axis=1)
    assert np.allclose(frame.positions[seen], truth(model, data)[seen])
    assert frame.names == MARKERS


@given(seed=st.integers(0, 10**6), count=st.integers(1, 7))
@settings(max_examples=25, deadline=None)
def test_more_cameras_never_see_less(seed, count):
    model, data = pose(seed)
    few = MotionCapture(model, SITES, CAMERAS[:count], noise=0.0).visible(data)
    more = MotionCapture(model, SITES, CAMERAS[: count + 1], noise=0.0).visible(data)
    assert np.all(more[few])
    if count == 1:
        assert not few.any()


@given(seed=st.integers(0, 10**6), dropped=st.integers(0, 7))
@settings(max_examples=25, deadline=None)
def test_visibility_is_that_of_rays_one_by_one(seed, dropped):
    """Whatever order the cameras are asked in: seen means two free lines of sight within the fields of view."""
    model, data = pose(seed)
    mocap = MotionCapture(model, SITES, CAMERAS, noise=0.0)
    for _ in range(3):
        mocap.visible(data)
    group = np.array([1, 0, 0, 1, 1, 0], dtype=np.uint8)
    lines = np.zeros(len(SITES), dtype=int)
    for index, camera in enumerate(CAMERAS):
        if index == dropped:
            continue
        place = np.array(camera.position)
        axis = np.array(camera.target) - place
        for marker, point in enumerate(truth(model, data)):
            ray = point - place
            angle = np.arccos(ray @ axis / np.linalg.norm(ray) / np.linalg.norm(axis))
            share = mujoco.mj_ray(model, data, place, ray, group, 1, -1, np.zeros(1, np.int32))
            lines[marker] += angle <= camera.field_of_view / 2 and not 0.0 <= share <= 0.9995
    assert np.array_equal(mocap.visible(data, dropped), lines >= 2)


def test_a_wall_hides_the_front_from_cameras_before_it():
    front = tuple(MocapCamera((-1.5, y, 2.0), (1.45, 0.0, 1.2), 1.2) for y in (-1.0, 0.0, 1.0))
    results = {}
    for wall in (False, True):
        model, data = scene(wall)
        mujoco.mj_resetData(model, data)
        mujoco.mj_forward(model, data)
        results[wall] = MotionCapture(model, SITES, front).visible(data)
    chest = [MARKERS.index(f"CHEST{i}") for i in range(1, 5)]
    back = [MARKERS.index(f"BACK{i}") for i in range(1, 5)]
    assert results[False][chest].all()
    assert not results[False][back].any()
    assert not results[True].any()


def test_the_default_arena_sees_a_standing_person_whole():
    model, data = scene()
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    assert MotionCapture(model, SITES, CAMERAS).visible(data).all()


def test_the_device_counts_frames_and_has_a_clock_of_its_own():
    model, data = pose(0)
    mocap = MotionCapture(model, SITES, CAMERAS, seed=5)
    frames = [mocap.capture(data, k / 240) for k in range(200)]
    assert np.all(np.diff([frame.device_frame for frame in frames]) == 1)
    times = np.array([frame.device_time for frame in frames])
    assert times[0] != 0.0
    assert np.allclose(np.diff(times), 1 / 240, rtol=1e-4)


def test_the_same_seed_measures_the_same():
    model, data = pose(2)
    runs = []
    for seed in (1, 1, 2):
        mocap = MotionCapture(model, SITES, CAMERAS, seed=seed, occlusion=0.2)
        mocap.faults.set("ghost", 0.0)
        runs.append(np.array([mocap.capture(data, k / 240).positions for k in range(50)]))
    assert np.array_equal(runs[0], runs[1], equal_nan=True)
    assert not np.array_equal(runs[0], runs[2], equal_nan=True)


def test_occlusion_hides_the_wanted_share():
    model, data = scene()
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    mocap = MotionCapture(model, SITES, CAMERAS, seed=3)
    mocap.faults.set("occlusion", 0.0, 0.3)
    missing = np.mean([np.isnan(mocap.capture(data, k / 240).positions[:, 0]).mean() for k in range(2000)])
    assert 0.22 < missing < 0.38


def standing_capture(**options):
    model, data = scene()
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    return MotionCapture(model, SITES, CAMERAS, noise=0.0, **options), data, truth(model, data)


def test_a_label_swap_exchanges_two_markers():
    mocap, data, points = standing_capture()
    mocap.faults.set("label_swap", 0.0, duration=1.0)
    during, after = mocap.capture(data, 0.5).positions, mocap.capture(data, 1.5).positions
    wrong = np.flatnonzero(np.abs(during - points).max(axis=1) > 1e-9)
    assert len(wrong) == 2
    assert np.allclose(during[wrong], points[wrong[::-1]])
    assert np.allclose(after, points)


def test_a_ghost_stands_still_elsewhere():
    mocap, data, points = standing_capture()
    mocap.faults.set("ghost", 0.0)
    first, second = mocap.capture(data, 0.1).positions, mocap.capture(data, 0.2).positions
    wrong = np.flatnonzero(np.abs(first - points).max(axis=1) > 1e-9)
    assert len(wrong) == 1
    assert 0.1 < np.linalg.norm(first[wrong] - points[wrong]) < 0.5
    assert np.allclose(first, second)


def test_a_clock_jump_moves_the_device_time_only_and_a_freeze_repeats_the_last_frame():
    mocap, data, _ = standing_capture()
    before = mocap.capture(data, 1.0)
    mocap.faults.set("clock_jump", 1.0, -7.5, duration=1.0)
    jumped = mocap.capture(data, 1.1)
    assert np.isclose(jumped.device_time - before.device_time, 0.1 - 7.5, atol=1e-3)
    assert jumped.device_frame == before.device_frame + 1
    mocap.faults.set("none", 1.2)
    mocap.faults.set("freeze", 1.2, duration=0.5)
    assert mocap.capture(data, 1.3) is jumped
    later = mocap.capture(data, 1.8)
    assert later.device_frame == before.device_frame + 3
    assert np.isclose(later.device_time - before.device_time, 0.8, atol=1e-3)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"rate": -1.0}, "rate"),
        ({"rate": float("nan")}, "rate"),
        ({"noise": -0.001}, "noise"),
        ({"occlusion": 2.0}, "occlusion"),
        ({"cameras": ()}, "camera"),
        ({"sites": ["person/marker/TAIL"]}, "TAIL"),
    ],
)
def test_impossible_settings_are_refused(options, word):
    model, _ = scene()
    settings_ = {"sites": SITES, "cameras": CAMERAS, **options}
    with pytest.raises(BadModelError, match=word):
        MotionCapture(model, **settings_)
