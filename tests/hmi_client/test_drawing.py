"""Half blocks, braille, windows over images, and the map's projection."""

import math

import numpy as np
import pytest
from hmi_fakes import pose

from fleetpose.hmi_client.model.top_view import (
    ground_ellipse,
    heading_rad,
    position_covariance,
    position_sigma_m,
)
from fleetpose.hmi_client.tui.drawing import palette
from fleetpose.hmi_client.tui.drawing.arrangement import MIN_LOUPE, arrange, fit
from fleetpose.hmi_client.tui.drawing.cells import Canvas, HalfBlocks, Window, braille_of, sample
from fleetpose.hmi_client.tui.drawing.palette import style, tone
from fleetpose.hmi_client.tui.panels.map_panel import Projection, layout, nice_length
from fleetpose.hmi_client.tui.panels.matrix_panel import shorten


def colours(strip):
    return [
        (segment.style.color.triplet.hex, segment.style.bgcolor.triplet.hex)
        for segment in strip
        for _ in segment.text
    ]


def test_a_half_block_shows_two_pixels_with_five_bits_per_channel():
    image = np.array([[[1, 2, 255]], [[255, 130, 0]]], np.uint8)  # BGR: red above, blue below
    [strip] = HalfBlocks(image).rows().strips
    assert strip.text == "▀"
    assert colours(strip) == [("#ff0000", "#0084ff")]  # black and white stay what they are


def test_equal_cells_share_a_segment():
    strips = HalfBlocks(np.full((4, 10, 3), 80, np.uint8)).rows().strips
    assert [len(list(strip)) for strip in strips] == [1, 1]
    assert all(strip.cell_length == 10 for strip in strips)


def test_a_text_over_an_image_covers_its_cells_only():
    picture = HalfBlocks(np.full((4, 6, 3), 80, np.uint8))
    picture.text(4, 1, "12", "#000000", "#e69f00")
    picture.text(5, 0, "345", "#ffffff")  # cut at the edge
    first, second = picture.rows().strips
    assert (first.text, second.text) == ("▀▀▀▀▀3", "▀▀▀▀12")
    assert colours(second)[4] == ("#000000", "#e69f00")


def test_every_style_has_its_own_background():
    canvas = Canvas(4, 2)
    canvas.text(0, 0, "ab", style("#ffffff"))
    for strip in canvas.strips():
        assert all(segment.style.bgcolor.name == tone("back") for segment in strip)


def test_braille_has_dots_where_they_were_set():
    dots = np.zeros((4, 4), bool)
    dots[0, 0] = dots[3, 3] = True
    assert braille_of(dots) == ["⠁⢀"]


def test_a_window_shows_pixels_where_it_says():
    rng = np.random.default_rng(5)
    image = rng.integers(0, 255, (60, 80, 3), np.uint8)
    window = Window(left=10.0, top=20.0, px_per_half=0.5, columns=20, rows=10)
    shown = sample(image, window)
    for column in range(20):
        for half_row in range(20):
            u, v = (round(x) for x in window.pixel(column, half_row))
            assert (shown[half_row, column] == image[v, u]).all()


@pytest.mark.parametrize("px", [0.5, 1.0, 3.7])
def test_the_cell_of_a_pixel_shows_that_pixel(px):
    window = Window(left=3.0, top=4.0, px_per_half=px, columns=30, rows=20)
    for u, v in ((5, 6), (9, 9), (14, 12)):
        column, half_row = window.half_cell(u, v)
        back = window.pixel(column, half_row)
        assert abs(back[0] - u) <= px / 2 and abs(back[1] - v) <= px / 2


def test_a_smaller_jpeg_is_shown_at_the_same_place():
    image = np.zeros((120, 160, 3), np.uint8)
    image[40:80, 60:100] = 255
    half = image[::2, ::2]
    window = Window(left=40.0, top=20.0, px_per_half=2.0, columns=40, rows=20)
    difference = np.abs(sample(image, window).astype(int) - sample(half, window, scale=2.0))
    assert (difference > 40).mean() < 0.02


def test_beyond_the_image_is_not_its_border():
    shown = sample(np.full((10, 10, 3), 200, np.uint8), Window(-5.0, 0.0, 1.0, 10, 5))
    assert (shown[:, :5] < 50).all() and (shown[:, 5:] == 200).all()


@pytest.mark.parametrize(("columns", "rows"), [(33, 34), (70, 20), (46, 11), (78, 44)])
def test_image_and_loupe_fill_the_panel_and_do_not_overlap(columns, rows):
    place = arrange(columns, rows, 4 / 3)
    left, top, width, height = place.loupe
    assert width >= MIN_LOUPE[0] and height >= MIN_LOUPE[1]
    assert left + width <= columns and top + height <= rows
    assert left > place.columns or top >= place.rows


def test_a_small_panel_has_no_loupe():
    assert arrange(16, 7, 4 / 3).loupe is None


def test_a_zoomed_window_stays_on_the_image():
    place = arrange(60, 20, 1.5)
    window = fit(place, (768, 512), 4.0, (767.0, 0.0))
    assert window.top == 0.0
    assert window.left + window.columns * window.px_per_half == pytest.approx(768)


def test_the_map_has_the_origin_at_its_centre_and_north_up():
    projection = Projection(40, 30, 0.1)
    assert projection.dots(np.zeros((1, 2))).tolist() == [[40.0, 60.0]]
    x, y = projection.dots(np.array([[1.0, 2.0]]))[0]
    assert (x, y) == pytest.approx((50.0, 40.0))


@pytest.mark.parametrize("reach", [0.2, 3.0, 70.0])
def test_the_scale_fits_all_robots_and_does_not_waste_the_map(reach):
    xy = np.array([[reach, 0.0], [0.0, -reach / 3]])
    projection = Projection.fitting(40, 30, xy)
    dots = projection.dots(xy)
    assert (dots >= 0).all() and (dots < (80, 120)).all()
    assert dots[:, 0].max() > 40 + 40 * 0.8 / 1.25 - 1 or reach < 0.5


def test_the_scale_does_not_follow_small_motions():
    xy = np.array([[3.0, 1.0]])
    assert Projection.fitting(40, 30, xy) == Projection.fitting(40, 30, xy * 1.01)


def test_components_are_drawn_apart():
    poses = {
        "r1": pose("r1", 0.0, 0.0),
        "r2": pose("r2", 2.0, 1.0),
        "r3": pose("r3", 0.0, 0.0, component="r3"),
        "r4": pose("r4", 0.0, 1.0, component="r3"),
    }
    places = layout(poses, "r1")
    assert places["r1"].tolist() == [0.0, 0.0] and places["r2"].tolist() == [2.0, 1.0]
    assert max(places["r3"][1], places["r4"][1]) < -0.3
    assert np.allclose(places["r4"] - places["r3"], (0.0, 1.0))


def test_the_scale_bar_is_a_round_length():
    assert [nice_length(x) for x in (0.7, 1.0, 3.3, 49.0)] == [0.5, 1.0, 2.0, 20.0]


def test_the_heading_is_that_of_the_robots_x_axis():
    assert heading_rad(pose("r1", 0, 0, math.radians(130))) == pytest.approx(math.radians(130))


def test_a_rotation_of_the_fleet_moves_a_far_robot_more():
    covariance = np.diag([0.0, 0.0, 1e-4, 0.0, 0.0, 0.0])
    near = pose("r1", 1.0, 0.0, covariance=covariance)
    far = pose("r1", 10.0, 0.0, covariance=covariance)
    assert position_covariance(far)[1, 1] == pytest.approx(100 * position_covariance(near)[1, 1])
    assert position_sigma_m(far) == pytest.approx(0.1)


def test_the_ellipse_has_two_sigma():
    covariance = np.diag([0.0, 0.0, 0.0, 0.04, 0.01, 0.0])
    outline = ground_ellipse(pose("r1", 1.0, 2.0, covariance=covariance), points=360)
    assert np.allclose(np.ptp(outline, axis=0) / 2, (0.4, 0.2), atol=1e-3)
    assert np.allclose(outline.mean(0), (1.0, 2.0))


def test_long_names_keep_their_end():
    assert shorten("warehouse-robot-17", 6) == "…ot-17"


def test_a_terminal_of_16_colours_gets_greys_that_are_brighter_where_the_image_is():
    ramp = np.repeat(np.arange(0, 256, 4, dtype=np.uint8)[None, :, None], 16, axis=0)
    palette.has("standard")
    try:
        picture = HalfBlocks(np.repeat(ramp, 3, axis=2))
    finally:
        palette.has("truecolor")
    shades = np.vstack((picture.top, picture.bottom)) & 0xFF
    assert set(np.unique(shades)) == {0x00, 0x55, 0xAA, 0xFF}
    brightness = shades.mean(axis=0).reshape(-1, 8).mean(axis=1)
    assert (np.diff(brightness) > 0).all()
    assert np.abs(brightness - ramp[0, :, 0].reshape(-1, 8).mean(axis=1)).max() < 12
