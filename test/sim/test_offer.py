"""An object is offered when the robot holds it still, away from the tables."""

import numpy as np
import pytest

from handover_ros.geometry import transform_from_xyz_rpy
from handover_ros.objects.scene import load_scene
from handover_ros.sim.offer import OfferWatch

OUT, OVER_TABLE, HIGH = (0.95, 0.0, 1.1), (0.6, 0.6, 0.9), (0.6, 0.6, 1.3)


def watched(position, speed=0.0, held=True, seconds=1.0):
    watch, offered = OfferWatch(load_scene("lab")), None
    for time in np.arange(0.0, seconds, 0.01):
        poses = {"mug": transform_from_xyz_rpy(position)}
        offered = watch.update(time, {"mug": "left"} if held else {}, poses, {"mug": speed})
    return watch, offered


@pytest.mark.parametrize(
    ("position", "speed", "held", "seconds", "offered"),
    [
        (OUT, 0.0, True, 1.0, "mug"),
        (HIGH, 0.0, True, 1.0, "mug"),
        (OUT, 0.0, True, 0.3, None),
        (OUT, 0.1, True, 1.0, None),
        (OUT, 0.0, False, 1.0, None),
        (OVER_TABLE, 0.0, True, 1.0, None),
    ],
)
def test_offered_when_held_still_away_from_tables(position, speed, held, seconds, offered):
    assert watched(position, speed, held, seconds)[1] == offered


def test_touch_does_not_end_an_offer_but_withdrawal_does():
    watch, _ = watched(OUT)
    poses = {"mug": transform_from_xyz_rpy(OUT)}
    assert watch.update(2.0, {"mug": "left"}, poses, {"mug": 0.1}) == "mug"
    assert watch.update(2.1, {"mug": "left"}, poses, {"mug": 0.5}) is None
    watch, _ = watched(OUT)
    assert watch.update(2.0, {}, poses, {"mug": 0.0}) is None


def test_low_over_another_table_counts_and_over_its_own_not():
    """The person's own table is often where a handover is cheapest; the robot's is where it takes things from."""
    scene = load_scene("lab")
    goal = scene.goals["mug"][:3, 3]
    watch, offered = OfferWatch(scene), []
    for number, position in enumerate([OVER_TABLE] * 100 + [tuple(goal + [0.0, 0.0, 0.06])] * 100 + [OVER_TABLE] * 100):
        moving = 0.5 if number in (100, 200) else 0.0
        poses = {"mug": transform_from_xyz_rpy(position)}
        offered.append(watch.update(0.01 * number, {"mug": "left"}, poses, {"mug": moving}))
    assert offered[99] is None
    assert offered[199] == "mug"
    assert offered[299] is None
