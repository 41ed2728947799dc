"""Robots given as MJCF or URDF: contact-free trees of hinges and slides."""

from deepkoco.systems.trees.tree import Tree, TreeError
from deepkoco.systems.trees.tree_system import TreeSystem

__all__ = ["Tree", "TreeError", "TreeSystem"]
