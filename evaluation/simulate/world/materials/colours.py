"""Colours (BGR) of the materials of the synthetic world."""

from fleetpose.evaluation.simulate.world.materials.textures import Colour


def _listed(text: str) -> list[Colour]:
    """Colours written as blue-green-red, with commas between them."""
    values = (one.split("-") for one in text.split(", "))
    return [(int(b), int(g), int(r)) for b, g, r in values]


BRICK = [(62, 78, 150), (70, 88, 165), (55, 66, 128), (80, 100, 172), (64, 74, 112)]
STONE = [(150, 168, 182), (138, 156, 172), (160, 176, 186), (128, 142, 160), (146, 158, 166)]
RED_TILES = [(50, 70, 150), (60, 85, 170), (45, 60, 130), (70, 100, 180)]
SLATE = [(95, 88, 80), (110, 100, 92), (80, 76, 72), (120, 116, 105)]
COPPER = [(150, 165, 110), (140, 150, 95), (165, 178, 125), (120, 130, 90)]
GREY = [(130, 134, 138), (118, 122, 128), (142, 146, 148), (108, 112, 116)]
RENDERS = _listed("150-190-215, 165-185-195, 120-165-205, 175-170-150, 140-160-200, 150-178-160")
PAINTS = _listed("60-50-150, 120-80-40, 60-110-60, 40-120-190, 110-60-110, 50-45-45")
PRINTS = _listed(  # what posters, curtains and window frames are coloured with
    "45-50-165, 70-120-215, 95-185-225, 150-190-215, 205-220-230, 150-130-60, "
    "130-85-35, 90-120-60, 75-85-95, 40-40-45, 120-160-150, 110-95-175"
)
WORDS = ("CAFE", "BAKERY", "OPEN", "JAZZ", "MARKET", "CIRCUS", "BOOKS", "TEA", "LIVE", "NORD")
WORDS += ("OPERA", "ROBOTS", "7", "24", "EXPO", "FILM")
