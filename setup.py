"""Which packages a wheel holds: pyproject.toml cannot both find packages and map a folder into one of them."""

from setuptools import find_namespace_packages, setup

FOUND = find_namespace_packages(
    include=["deepkoco", "deepkoco.*", "baselines", "baselines.*", "hydra_plugins"], exclude=["*.__pycache__"]
)

setup(packages=[*FOUND, "deepkoco.configs"], package_dir={"deepkoco.configs": "configs"})
