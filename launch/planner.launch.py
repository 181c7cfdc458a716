# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Start the planner.

For example ``ros2 launch mp_pca_planner planner.launch.py primitives:="[/path/reach.npz]"
controller_topic:=/arm_controller/joint_trajectory``; ``--show-args`` lists all arguments, among
them every parameter of the node.
"""

import subprocess

import yaml
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from mp_pca_planner.execution.parameters import DECLARATIONS

PACKAGE = "mp_pca_planner"
PARAMETERS = {declaration.name: declaration for declaration in DECLARATIONS}


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "robot_description_file",
                default_value="",
                description="URDF or xacro file; empty: as the parameter robot_description says",
            ),
            DeclareLaunchArgument(
                "xacro_arguments",
                default_value="",
                description="arguments of the xacro file, NAME:=VALUE, separated by spaces",
            ),
            DeclareLaunchArgument(
                "robot_description_topic",
                default_value="robot_description",
                description="topic of the URDF",
            ),
            DeclareLaunchArgument(
                "joint_states_topic",
                default_value="joint_states",
                description="topic of the joint states",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value=PathJoinSubstitution(
                    [FindPackageShare(PACKAGE), "config", "planner.yaml"]
                ),
                description="parameters of the node; the arguments below override them",
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
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                choices=["true", "false"],
                description="whether the time is that of the topic /clock",
            ),
            *map(_parameter_argument, PARAMETERS),
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


def _parameter_argument(name: str) -> DeclareLaunchArgument:
    text = f"{PARAMETERS[name].description} By default as in params_file."
    return DeclareLaunchArgument(name, default_value="", description=text)


def _parameter_value(name: str, text: str) -> object:
    """The value of a parameter; a single text is a list of one where a list is accepted."""
    declaration = PARAMETERS[name]
    kind = type(declaration.default)
    if kind is str:
        return text
    if kind is tuple:
        return yaml.safe_load(text) if text.startswith("[") else [text]
    try:
        value = yaml.safe_load(text)
        if isinstance(value, bool) == (kind is bool):
            return kind(value)
    except (ValueError, TypeError, yaml.YAMLError):
        pass
    raise ValueError(f"{name}:={text} is not accepted: it must be {declaration.accepted}")


def _robot_description(file: str, xacro_arguments: str) -> str:
    """The URDF in a file, which xacro makes if it is a xacro file."""
    if file.endswith(".xacro"):
        command = ["xacro", file, *xacro_arguments.split()]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    with open(file, encoding="utf-8") as urdf:
        return urdf.read()


def _planner_node(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    # Only now are the values known, and an empty one must not hide that of params_file.
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    given = {name: value(name) for name in PARAMETERS}
    overrides = {name: _parameter_value(name, text) for name, text in given.items() if text}
    if value("use_sim_time") == "true":
        overrides["use_sim_time"] = True
    if value("robot_description_file"):
        # Not a substitution: it would be read as YAML, which a URDF may look like.
        file, arguments = value("robot_description_file"), value("xacro_arguments")
        overrides["robot_description"] = _robot_description(file, arguments)
    parameters: list[object] = [value("params_file")]
    if overrides:
        parameters.append(overrides)
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
                ("joint_states", value("joint_states_topic")),
            ],
        )
    ]
