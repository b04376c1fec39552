"""Measurements over the picture: lines on a dark edge and labels on dark plates, to be read on any background."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from imgui_bundle import ImVec2, imgui

from viewer.app.annotations import Measurement, Point
from viewer.app.application import App
from viewer.app.measure_tool import PAGE, LengthFormat, angle, lengths
from viewer.app.pose import triple
from viewer.panels import theme
from viewer.panels.overlays import Box, Screen
from viewer.panels.widgets import chip, chip_size, px

REACH = 11.0  # of a point's handle, units
ARC_SHARE, ARC_STEPS = 0.25, 16  # of an angle's shorter side; pieces that its arc is drawn as


class Handle(NamedTuple):
    """A point that can be dragged: of which measurement, and which of its points."""

    measurement: int
    point: int


def draw(app: App, box: Box, over: bool) -> Handle | None:
    """Draws what was measured and what is being measured; the point under the mouse, if any.

    over: the mouse is over the picture and nothing lies above that.
    """
    measure_tool, words = app.measure_tool, app.measure_tool.length_format(app)
    active = bool(measure_tool.tool) or app.interface.shows(PAGE)
    if words is None or app.scene is None or not (active or measure_tool.shown):
        measure_tool.look_away()
        return None
    mouse = imgui.get_io().mouse_pos
    if over and active:
        measure_tool.look_at(app, mouse.x - box[0], mouse.y - box[1])
    else:
        measure_tool.look_away()
    screen, draw_list = Screen(app, box), imgui.get_window_draw_list()
    draw_list.push_clip_rect(ImVec2(box[0], box[1]), ImVec2(box[0] + box[2], box[1] + box[3]), True)
    measurements = app.annotations.current.measurements
    under = _handle_at(screen, measurements, mouse) if over and active else None
    for index, measurement in enumerate(measurements):
        hot = under.point if under is not None and under.measurement == index else None
        _measurement(screen, words, measurement, index == measure_tool.selected, hot)
    _draft(app, screen, words, None if under is not None else measure_tool.cursor and triple(measure_tool.cursor.point))
    draw_list.pop_clip_rect()
    return under


def _handle_at(screen: Screen, measurements: tuple[Measurement, ...], mouse: ImVec2) -> Handle | None:
    best, nearest = None, px(REACH)
    for index, measurement in enumerate(measurements):
        places, before = screen.points(np.asarray(measurement.points))
        for point, place in enumerate(places):
            away = float(np.hypot(place.x - mouse.x, place.y - mouse.y))
            if before[point] and away < nearest:
                best, nearest = Handle(index, point), away
    return best


def _measurement(screen: Screen, words: LengthFormat, measurement: Measurement, chosen: bool, hot: int | None) -> None:
    colour = theme.WARN if chosen else theme.ACCENT
    points = measurement.points
    _line(screen, points, colour)
    if measurement.kind == "point":
        _label(screen, points[0], words.measurement(measurement), below=True)
    elif measurement.kind == "angle":
        _arc(screen, points, colour)
        _label(screen, points[1], words.measurement(measurement), below=True)
    else:
        _lengths(screen, words, points)
    _dots(screen, points, colour, hot)


def _draft(app: App, screen: Screen, words: LengthFormat, cursor: Point | None) -> None:
    """The points placed so far, a line to where the mouse is, and what that would measure."""
    measure_tool = app.measure_tool
    if not measure_tool.tool:
        return
    waits = cursor is not None and not (measure_tool.tool == "scale" and len(measure_tool.draft) == 2)
    points = (*measure_tool.draft, cursor) if waits and cursor is not None else measure_tool.draft
    _line(screen, points, theme.WARN)
    if measure_tool.tool == "angle" and len(points) == 3:
        _arc(screen, points, theme.WARN)
        _label(screen, points[1], f"{angle(points):.1f}°", below=True)
    elif len(points) > 1:
        _lengths(screen, words, points)
    elif measure_tool.tool == "point" and points:
        _label(screen, points[0], words.place(points[0]), below=True)
    _dots(screen, points, theme.WARN, None)


def _lengths(screen: Screen, words: LengthFormat, points: tuple[Point, ...]) -> None:
    """The length of each piece in its middle, and of all together at the last point."""
    pieces = lengths(points)
    for (a, b), piece in zip(pairwise(points), pieces, strict=True):
        _label(screen, triple(0.5 * (np.asarray(a) + np.asarray(b))), words.length(piece))
    if len(pieces) > 1:
        _label(screen, points[-1], f"total {words.length(sum(pieces))}", below=True)


def _line(screen: Screen, points: tuple[Point, ...], colour: str) -> None:
    edges = [(i, i + 1) for i in range(len(points) - 1)]
    if edges:
        screen.lines(np.asarray(points), edges, theme.packed(theme.BASE, 0.75), px(5))
        screen.lines(np.asarray(points), edges, theme.packed(colour), px(2))


def _arc(screen: Screen, points: tuple[Point, ...], colour: str) -> None:
    """Between the two sides of an angle, at the middle one of three points."""
    a, b, c = (np.asarray(point) for point in points)
    sides = [float(np.linalg.norm(end - b)) for end in (a, c)]
    if min(sides) <= 0:
        return
    one, two = (a - b) / sides[0], (c - b) / sides[1]
    share = np.linspace(0.0, 1.0, ARC_STEPS)[:, None]
    way = (1 - share) * one + share * two
    size = np.linalg.norm(way, axis=1, keepdims=True)
    if size.min() < 1e-6:  # a straight angle has no plane
        return
    arc = b + ARC_SHARE * min(sides) * way / size
    edges = [(i, i + 1) for i in range(ARC_STEPS - 1)]
    screen.lines(arc, edges, theme.packed(theme.BASE, 0.75), px(4))
    screen.lines(arc, edges, theme.packed(colour), px(1.5))


def _dots(screen: Screen, points: tuple[Point, ...], colour: str, hot: int | None) -> None:
    if not points:
        return
    places, before = screen.points(np.asarray(points))
    draw = imgui.get_window_draw_list()
    for i, place in enumerate(places):
        if before[i]:
            size = 7.0 if i == hot else 4.5
            draw.add_circle_filled(place, px(size + 2), theme.packed(theme.BASE, 0.85))
            draw.add_circle_filled(place, px(size), theme.packed(colour))
            draw.add_circle_filled(place, px(1.5), theme.packed(theme.BASE))


def _label(screen: Screen, at: Point, text: str, *, below: bool = False) -> None:
    """A label at a point of the scene: on its middle, or just below."""
    places, before = screen.points(np.asarray([at]))
    if before[0]:
        width, height = chip_size(text)
        chip(text, places[0].x - 0.5 * width, places[0].y + (px(12) if below else -0.5 * height))
