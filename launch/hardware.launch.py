"""The cell with a real robot and real motion capture: ``ros2 launch handover_ros hardware.launch.py``.

The robot's driver and the motion capture are started by their own packages, on the topics that README.md names; the
nodes run on the machine's clock.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription

ARGUMENTS = ("config", "record", "bag", "log_level")


def generate_launch_description() -> LaunchDescription:
    """Describe the launch arguments and the nodes: those of cell.launch.py without the simulator."""
    share = Path(get_package_share_directory("handover_ros"))
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config", default_value=str(share / "config"), description="Folder of the nodes' parameter files."
            ),
            DeclareLaunchArgument("record", default_value="true", description="Record everything said in the graph."),
            DeclareLaunchArgument(
                "bag", default_value="", description="Folder of the bag; empty: handover_out/bag-<date>-<time>."
            ),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn or error."),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(str(share / "launch" / "cell.launch.py")),
                launch_arguments={"simulated": "false", **given}.items(),
            ),
        ]
    )
