"""Textured worlds whose truth is known to the last digit: a town square with robots in a ring, and
plans of alike parts that fool.
"""

from fleetpose.evaluation.simulate.world.plans.planned import PLANS, PlanWorld
from fleetpose.evaluation.simulate.world.render import Renderer, Rendering
from fleetpose.evaluation.simulate.world.ring import RingWorld, ring_rig
from fleetpose.evaluation.simulate.world.robots import StereoShot, World
from fleetpose.evaluation.simulate.world.town import town_square

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
