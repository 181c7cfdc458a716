# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Build description for colcon (ament_python) and for pip."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "mp_pca_planner"

setup(
    name=PACKAGE,
    # Also in package.xml and mp_pca_planner/__init__.py: catkin_prepare_release wants literals.
    version="0.1.0",
    description=(
        "Movement primitives from recorded demonstrations by principal component analysis, "
        "and least-effort arm motions optimised over their weights"
    ),
    long_description=Path(__file__).with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author="mp_pca_planner developers",
    license="Apache-2.0",
    license_files=["LICENSE"],
    keywords=[
        "robotics",
        "ros2",
        "motion planning",
        "movement primitives",
        "learning from demonstration",
        "trajectory optimization",
        "principal component analysis",
    ],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Intended Audience :: Science/Research",
        "Intended Audience :: Developers",
        "Operating System :: POSIX :: Linux",
        "Programming Language :: Python :: 3",
        "Programming Language :: Python :: 3.11",
        "Programming Language :: Python :: 3.12",
        "Programming Language :: Python :: 3.13",
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    python_requires=">=3.11",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed", "plotting/*.mplstyle", "plotting/templates/*.html"]},
    zip_safe=False,
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/config", sorted(glob("config/*"))),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.py"))),
        # Not console_scripts: pip would put commands called `plan` and `inspect` into bin/, where
        # `ros2 run` does not look; colcon and pip both honour data_files, keep the mode bits, and
        # put the executables where it does.
        (f"lib/{PACKAGE}", sorted(glob("scripts/ros2_run/*"))),
    ],
    # The one name that is safe in bin/: all commands are its first argument.
    entry_points={"console_scripts": [f"mp-pca = {PACKAGE}.__main__:main"]},
    # What pip must bring when nothing is there. A ROS workspace takes its dependencies from
    # package.xml instead, where Pinocchio and rosbags may come without the metadata called `pin`
    # and `rosbags`. That does no harm: colcon installs without dependencies, and no script that
    # checks this list at start is generated.
    install_requires=[
        "numpy>=1.26",
        "scipy>=1.11",
        "pin>=3.4",
        "rosbags>=0.11.9,<0.12",
        "lz4",  # as rosbags does
        "PyYAML>=6.0",
        "tqdm>=4.66",
        "threadpoolctl>=3.1",
        "argcomplete>=2.0",  # completion of commands in a shell
        # Mesh files of links and obstacles: STL and OBJ, and COLLADA.
        "trimesh>=4.6",
        "pycollada>=0.8",
        # Detours around obstacles; there are no wheels for later versions of Python.
        "ompl>=2.0; python_version < '3.14'",
    ],
    extras_require={
        # ROS 2 Jazzy for machines without one: wheels for x86-64 Linux.
        "ros": [
            "ros-jazzy-rclpy[fastrtps]==7.1.6",
            "ros-jazzy-common-interfaces==5.3.6",
        ],
        # Pictures, and the pages that hold them.
        "plot": ["matplotlib>=3.6", "jinja2>=3.0"],
        # The page in the browser.
        "view": ["jinja2>=3.0", "rich>=13.0", "viser>=1.1"],
        # To compare with: ProMP, DMP, optimal control, time-optimal paths; arms of another physics.
        "peers": [
            "movement_primitives>=0.9",
            "pytransform3d>=3.5",  # movement_primitives imports it, but doesn't ask for it
            "crocoddyl>=3.2",
            "toppra>=0.6.9",
            "mujoco>=3.3",
            "mujoco-menagerie",
            "example-robot-data-loaders>=4.4",  # brings the models, example-robot-data
        ],
        # Datasets of LeRobot as demonstrations: their Parquet files are read.
        "lerobot": ["pyarrow>=15.0"],
        # The panda of the demo, with meshes.
        "example": ["example-robot-data-loaders>=4.4"],
        # The documentation site.
        "doc": [
            "sphinx>=7.0",
            "sphinx-copybutton>=0.5",
            "myst-parser>=3.0",
            "furo",
            "matplotlib>=3.6",
        ],
        # Learning by trials: CMA-ES.
        "learn": ["cmaes>=0.10"],
        # Recordings read by the workers of a Dask cluster.
        "dask": ["distributed>=2024.1"],
        # colcon runs pytest only if it is named here. Checkers whose verdict changes from one
        # release to the next are held.
        "test": [
            "cmaes>=0.10",
            "distributed>=2024.1",
            "example-robot-data-loaders>=4.4",  # the arms of the demo and of moving robots
            "hypothesis>=6.100",
            "mypy==2.4.*",
            "playwright>=1.45",
            "pyarrow>=15.0",
            "pytest>=7.4",
            "pytest-xdist>=3.5",
            "rich>=13.0",
            "ruff==0.17.*",
            "setuptools>=70.1",
            "types-PyYAML",
            "types-tqdm",
            "viser>=1.1",
        ],
    },
)
