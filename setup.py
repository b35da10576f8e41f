"""Installs handover_ros as an ament_python package."""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "handover_ros"
NODES = [
    "sim_node",
    "mocap_node",
    "skeleton_node",
    "calibration_node",
    "planner_node",
    "preference_node",
    "executive_node",
    "recorder_node",
    "player_node",
]


def config_data_files():
    """List config/ and launch/ for installation under share/handover_ros, folder by folder."""
    folders = [folder for root in ("config", "launch") for folder in (Path(root), *sorted(Path(root).rglob("*/")))]
    return [
        (f"share/{PACKAGE}/{folder}", [str(path) for path in sorted(folder.glob("*")) if path.is_file()])
        for folder in folders
        if folder.is_dir() and folder.name != "__pycache__"
    ]


setup(
    name=PACKAGE,
    version="0.1.0",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *config_data_files(),
    ],
    install_requires=[
        "setuptools",
        "numpy>=1.26",
        "scipy>=1.11",
        "pin>=3.4,<5",
        "example-robot-data>=4.3",
        "mujoco>=3.3,<5",
        "filterpy>=1.4.5",
        "numba>=0.60",
        "trimesh>=4.0",
        "pycollada>=0.8",
        "ezc3d>=1.5",
        "pydantic>=2.6,<3",
        "PyYAML>=6.0",
        "markdown-it-py>=2.2",
        "matplotlib>=3.8",
        "rich>=13.0",
        "typer>=0.12",
        "toppra>=0.6",
        "rosbags>=0.10",
        "mcap>=1.2,<2",
        "zstandard>=0.21",
        "pillow>=10.0",
        "threadpoolctl>=3.2",
        "joblib>=1.3",
    ],
    extras_require={
        "test": ["pytest<9", "hypothesis>=6.80", "ruff>=0.5", "mypy>=1.8", "mkdocs>=1.6,<2"],
        # Whom ./handover bench measures against; it installs them by itself, in a folder of their own.
        "bench": ["biorbd==1.12.4", "EAIK==1.2.2", "ssik==8.2.0", "cython==3.3.1"],
    },
    zip_safe=True,
    maintainer="The handover_ros maintainers",
    maintainer_email="maintainers@handover-cell.org",
    description="A live handover cell: a robot hands objects to a person so that it suits that person.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            *(f"{node} = {PACKAGE}.nodes.{node}:main" for node in NODES),
            f"handover = {PACKAGE}.cli:main",
        ]
    },
)
