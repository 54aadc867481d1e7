"""Installs with colcon, as an ament_python package, and with pip."""

from setuptools import setup

NAME = "eitskin_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    python_requires=">=3.10",
    install_requires=["msgpack", "pyzmq", "setuptools"],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/skin.launch.xml"]),
        (f"share/{NAME}/config", ["config/skin.yaml", "config/skin.rviz"]),
    ],
    entry_points={"console_scripts": [f"skin = {NAME}.node:main"]},
)
