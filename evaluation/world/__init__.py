"""Textured worlds whose truth is known to the last digit: a town square with robots in a ring, and
plans of alike parts that fool.
"""

from evaluation.world.planned import PLANS, PlanWorld
from evaluation.world.render import Renderer, Rendering
from evaluation.world.ring import RingWorld, ring_rig
from evaluation.world.robots import StereoShot, World
from evaluation.world.town import town_square

__all__ = [
    "PLANS",
    "PlanWorld",
    "Renderer",
    "Rendering",
    "RingWorld",
    "StereoShot",
    "World",
    "ring_rig",
    "town_square",
]
