"""Fills the caches of compiled kernels and converted meshes: ``python -m handover_ros.cell.warm_up``.

Set-up runs it once, so that the first start of the cell is as quick as the later ones.
"""

from handover_ros.objects.catalogue import load_catalogue
from handover_ros.objects.scene import load_scene
from handover_ros.planning import HandoverPlanner, load_schemes
from handover_ros.preferences.warm_up import warm_up_preferences
from handover_ros.robot.model import RobotModel
from handover_ros.sim.simulation import Simulation
from handover_ros.skeleton.warm_up import warm_up_calibration, warm_up_tracking


def warm_up(scene_name: str = "lab") -> None:
    """Make, and throw away, what the nodes make when they start."""
    scene = load_scene(scene_name)
    Simulation(scene)
    HandoverPlanner(RobotModel.load(scene.robot), scene, load_catalogue(), load_schemes()).warm_up()
    warm_up_tracking()
    warm_up_calibration()
    warm_up_preferences()


if __name__ == "__main__":
    warm_up()
