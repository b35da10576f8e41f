"""Objects that are handed over: their shape, their grasps as Task Space Regions, and the scene they stand in."""

from handover_ros.objects.catalogue import ObjectModel, Primitive, RobotGrasp, load_catalogue, load_object
from handover_ros.objects.regions import TaskSpaceRegion
from handover_ros.objects.scene import Camera, Scene, SceneBox, load_scene

__all__ = [
    "Camera",
    "ObjectModel",
    "Primitive",
    "RobotGrasp",
    "Scene",
    "SceneBox",
    "TaskSpaceRegion",
    "load_catalogue",
    "load_object",
    "load_scene",
]
