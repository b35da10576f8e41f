"""A bag drives the real nodes: ``ros2 launch handover_ros replay.launch.py bag:=/path/to/bag [speed:=2.0]``."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

DRIVABLE = ("mocap_node", "skeleton_node", "preference_node")
STOP_SECONDS = "3"  # grace after SIGINT, then after SIGTERM


def start_nodes(context) -> list:
    """Return the node actions: those to drive, and the player; when the bag is played everything ends."""
    config = Path(LaunchConfiguration("config").perform(context))
    wanted = LaunchConfiguration("nodes").perform(context).split()
    if unknown := set(wanted) - set(DRIVABLE):
        raise RuntimeError(
            f"nodes: {', '.join(sorted(unknown))} cannot be driven by a bag; known: {', '.join(DRIVABLE)}"
        )
    player = Node(
        package="handover_ros",
        executable="player_node",
        name="player_node",
        parameters=[
            {
                "bag": ParameterValue(LaunchConfiguration("bag"), value_type=str),
                "speed": ParameterValue(LaunchConfiguration("speed"), value_type=float),
                "start": ParameterValue(LaunchConfiguration("start"), value_type=float),
                "nodes": ParameterValue(" ".join(wanted), value_type=str),
            }
        ],
        output="screen",
        sigterm_timeout=STOP_SECONDS,
        sigkill_timeout=STOP_SECONDS,
    )
    driven = [
        Node(
            package="handover_ros",
            executable=name,
            name=name,
            parameters=[str(config / f"{name}.yaml"), {"use_sim_time": True}],
            output="screen",
            sigterm_timeout=STOP_SECONDS,
            sigkill_timeout=STOP_SECONDS,
        )
        for name in wanted
    ]
    ended = RegisterEventHandler(OnProcessExit(target_action=player, on_exit=[EmitEvent(event=Shutdown())]))
    return [*driven, ended, player]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch arguments and the nodes."""
    share = Path(get_package_share_directory("handover_ros"))
    profile = str(share / "config" / "fastdds.xml")
    return LaunchDescription(
        [
            DeclareLaunchArgument("bag", description="Folder of a bag or of a session, or a file."),
            DeclareLaunchArgument("speed", default_value="1.0", description="Recorded seconds per second."),
            DeclareLaunchArgument("start", default_value="0.0", description="Where to begin [s]."),
            DeclareLaunchArgument(
                "nodes",
                default_value="skeleton_node preference_node",
                description="Nodes that are driven, space between: mocap_node skeleton_node preference_node.",
            ),
            DeclareLaunchArgument(
                "config", default_value=str(share / "config"), description="Folder of the nodes' parameter files."
            ),
            SetEnvironmentVariable(
                "ROS_AUTOMATIC_DISCOVERY_RANGE",
                EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
            ),
            SetEnvironmentVariable(
                "FASTRTPS_DEFAULT_PROFILES_FILE",
                EnvironmentVariable("FASTRTPS_DEFAULT_PROFILES_FILE", default_value=profile),
            ),
            OpaqueFunction(function=start_nodes),
        ]
    )
