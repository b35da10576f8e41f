"""A study small enough for tests."""

from dataclasses import replace

from handover_ros.studies.chapter4_settings import load_chapter4_settings
from handover_ros.studies.chapter4_study import CHAPTER4


def small_settings(**changes):
    full = load_chapter4_settings()
    return full.model_copy(
        update={
            "people": 3,
            "particles": 100,
            "menu": 4,
            "planar": full.planar.model_copy(update={"queries": 3, "test_objects": 20}),
            "artificial": full.artificial.model_copy(update={"queries": 3}),
            "gallery": full.gallery.model_copy(update={"objects": 2, "looked_at": 12}),
            "arm": full.arm.model_copy(update={"queries": 2, "test_poses": 4, "configurations": 60}),
            "user_study": full.user_study.model_copy(update={"queries": 3, "poses": 2, "test_poses": 2}),
            **changes,
        }
    )


def small_study(**changes):
    settings = small_settings(**changes)
    return replace(CHAPTER4, settings=lambda quick: settings, figures=lambda *_: [])
