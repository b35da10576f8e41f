"""The whole cell, recorded: ``ros2 launch handover_ros cell.launch.py [simulated:=false] [record:=false]``."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from launch import LaunchDescription

NODES = (
    "sim_node",
    "mocap_node",
    "skeleton_node",
    "calibration_node",
    "planner_node",
    "preference_node",
    "executive_node",
)
STOP_SECONDS = "3"  # grace after SIGINT, then after SIGTERM


def start_nodes(context) -> list[Node]:
    """Return the node actions; each node takes its parameters from ``<config>/<node>.yaml``, if there is one."""
    config = Path(LaunchConfiguration("config").perform(context))
    simulated = LaunchConfiguration("simulated")
    actions = []
    for name in NODES:
        parameters = [str(config / f"{name}.yaml")] if (config / f"{name}.yaml").is_file() else []
        if name != "sim_node":  # it owns the clock
            parameters.append({"use_sim_time": ParameterValue(simulated, value_type=bool)})
        actions.append(
            Node(
                package="handover_ros",
                executable=name,
                name=name,
                parameters=parameters,
                arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
                output="screen",
                condition=IfCondition(simulated) if name == "sim_node" else None,
                sigterm_timeout=STOP_SECONDS,
                sigkill_timeout=STOP_SECONDS,
            )
        )
    recorder = [str(config / "recorder_node.yaml")] if (config / "recorder_node.yaml").is_file() else []
    actions.append(
        Node(
            package="handover_ros",
            executable="recorder_node",
            name="recorder_node",
            parameters=[*recorder, {"bag": ParameterValue(LaunchConfiguration("bag"), value_type=str)}],
            output="screen",
            condition=IfCondition(LaunchConfiguration("record")),
            sigterm_timeout=STOP_SECONDS,
            sigkill_timeout=STOP_SECONDS,
        )
    )
    return actions


def generate_launch_description() -> LaunchDescription:
    """Describe the launch arguments and the nodes."""
    share = Path(get_package_share_directory("handover_ros"))
    profile = str(share / "config" / "fastdds.xml")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "simulated", default_value="true", description="Start the simulator and follow its clock."
            ),
            DeclareLaunchArgument(
                "config", default_value=str(share / "config"), description="Folder of the nodes' parameter files."
            ),
            DeclareLaunchArgument("record", default_value="true", description="Record everything said in the graph."),
            DeclareLaunchArgument(
                "bag", default_value="", description="Folder of the bag; empty: handover_out/bag-<date>-<time>."
            ),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn or error."),
            SetEnvironmentVariable(
                "ROS_AUTOMATIC_DISCOVERY_RANGE",
                EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
            ),
            SetEnvironmentVariable(
                "FASTRTPS_DEFAULT_PROFILES_FILE",
                EnvironmentVariable("FASTRTPS_DEFAULT_PROFILES_FILE", default_value=profile),
            ),
            SetEnvironmentVariable("MALLOC_ARENA_MAX", EnvironmentVariable("MALLOC_ARENA_MAX", default_value="2")),
            OpaqueFunction(function=start_nodes),
        ]
    )
