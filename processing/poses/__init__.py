"""Poses of sources and photo, and the anchors that scale each light field."""

from lfrig.processing.poses.solution import PoseMethod, PoseSolution
from lfrig.processing.poses.solve import solve_poses
from lfrig.processing.poses.work import PoseWork

__all__ = ["PoseMethod", "PoseSolution", "PoseWork", "solve_poses"]
