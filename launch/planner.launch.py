# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Start the planner.

For example ``ros2 launch mp_pca_planner planner.launch.py primitives:=/path/reach.npz
controller_topic:=/arm_controller/joint_trajectory``; ``--show-args`` lists all arguments.
"""

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

PACKAGE = "mp_pca_planner"


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "primitives",
                default_value="",
                description="primitive file or folder of them; empty: as params_file says",
            ),
            DeclareLaunchArgument(
                "robot_description_file",
                default_value="",
                description="URDF file; empty: the URDF is taken from robot_description_topic",
            ),
            DeclareLaunchArgument(
                "robot_description_topic",
                default_value="robot_description",
                description="topic of the URDF",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution(
                    [FindPackageShare(PACKAGE), "config", "planner.yaml"]
                ),
                description="parameters of the node",
            ),
            DeclareLaunchArgument(
                "controller_topic",
                default_value="~/joint_trajectory",
                description="topic on which the controller expects trajectories",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="namespace of the node"
            ),
            DeclareLaunchArgument(
                "rviz",
                default_value="false",
                choices=["true", "false"],
                description="whether to show the robot and its planned motions in RViz",
            ),
            DeclareLaunchArgument(
                "fixed_frame",
                default_value="base_link",
                description="frame that RViz shows all in: the root link of the URDF, for example",
            ),
            # Before the planner, which would be left running if there is no RViz.
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=LaunchConfiguration("namespace"),
                arguments=[
                    "--display-config",
                    PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "planner.rviz"]),
                    "--fixed-frame",
                    LaunchConfiguration("fixed_frame"),
                ],
                # The names in planner.rviz are those of a planner without a namespace.
                remappings=[
                    (f"/{PACKAGE}/preview", f"{PACKAGE}/preview"),
                    ("/robot_description", LaunchConfiguration("robot_description_topic")),
                ],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
            OpaqueFunction(function=_planner_node),
        ]
    )


def _planner_node(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    # Only now are the values known, and an empty one must not hide that of params_file.
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    parameters: list[object] = [value("params_file")]
    if value("primitives"):
        parameters.append({"primitives": [value("primitives")]})
    if value("robot_description_file"):
        with open(value("robot_description_file"), encoding="utf-8") as urdf:
            # Not a substitution: it would be read as YAML, which a URDF may look like.
            parameters.append({"robot_description": urdf.read()})
    return [
        Node(
            package=PACKAGE,
            executable="planner_node",
            name=PACKAGE,
            namespace=value("namespace"),
            output="screen",
            parameters=parameters,
            remappings=[
                ("~/joint_trajectory", value("controller_topic")),
                ("robot_description", value("robot_description_topic")),
            ],
        )
    ]
