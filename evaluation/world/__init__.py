"""A textured world whose truth is known to the last digit: scene, renderer, and robots in a
ring.
"""

from evaluation.world.render import Renderer, Rendering
from evaluation.world.ring import RingWorld, StereoShot, ring_rig
from evaluation.world.town import town_square

__all__ = ["Renderer", "Rendering", "RingWorld", "StereoShot", "ring_rig", "town_square"]
