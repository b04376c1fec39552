"""Exports are of the whole pack and repeat, whatever the window's size, the machine's speed and its cores."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
import pytest
from PIL import Image

from scenepack import load_pack
from tests.viewer.offscreen_ui import OffscreenUi
from tests.viewer.waiting import until
from viewer.app.application import App
from viewer.commands.view import View
from viewer.features.film.film_export import Export, films_possible, write_film
from viewer.rendering.camera import ViewCamera
from viewer.rendering.canvas import Canvas
from viewer.rendering.settings import RenderSettings

DEMO = Path(__file__).parents[4] / "viewer" / "demo" / "demo.zip"
SIZE = (64, 64)  # x264 writes the same pictures of 48 × 32 in two ways, now and then
needs_video = pytest.mark.skipif(not films_possible(), reason="PyAV is not installed")


@pytest.mark.parametrize("name", [pytest.param("film.mp4", marks=needs_video), "still.png"])
def test_what_the_command_line_exports_depends_on_no_window(
    offscreen: Callable[..., OffscreenUi], pack_folder: Path, tmp_path: Path, name: str
) -> None:
    written = []
    for i, (window, page, frames) in enumerate([((900, 300), "", 3), ((480, 600), "film", 0)]):
        app = App()
        ui = offscreen(app, size=window)
        app.filming.fps = 2.0
        for _ in range(frames):  # which lay the window out before anything is open
            ui.frame()
        target = tmp_path / str(i) / name
        View(pack_folder, export=target, export_size=f"{SIZE[0]}x{SIZE[1]}", page=page).begin(app)
        until(lambda app=app, ui=ui: ui.frame() or (app.loading is None and app.filming.export is None))
        assert not app.messages.dialogs
        written.append(pictures_in(target))
    assert len(written[0]) == len(written[1]) > 0
    assert all(np.array_equal(a, b) for a, b in zip(*written, strict=True))


def pictures_in(path: Path) -> list[np.ndarray]:
    """Of a film or a still. The encoder rarely writes the same film in other bytes."""
    if path.suffix != ".mp4":
        return [np.asarray(Image.open(path))]
    import av

    with av.open(str(path), format="mp4") as film:
        return [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]


def test_tiles_of_any_size_make_the_same_pixels_also_where_the_lens_is_off_the_middle(
    ctx: moderngl.Context, tmp_path: Path
) -> None:
    pack = load_pack(DEMO)
    canvas = Canvas(ctx)
    try:
        canvas.show(pack)
        camera = ViewCamera.orbit(pack, 0.0, size=(301, 222))
        camera = replace(camera, cx=camera.cx + 0.3333, cy=camera.cy - 0.1717)
        pictures = []
        for side in (16, 97, 400):
            export = Export([camera], RenderSettings(), tmp_path / f"{side}.png", canvas.snapshot, tile_side=side)
            until(lambda export=export: export.step(1.0) or export.finished)
            pictures.append(np.asarray(Image.open(export.target)))
        assert np.ptp(pictures[0]) > 100
        assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])
    finally:
        canvas.close()


@needs_video
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system does not let us choose its cores")
def test_a_film_is_the_same_on_any_number_of_cores(tmp_path: Path) -> None:
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("there is one core only")
    noise = np.random.default_rng(0).normal(0.0, 1.0, (400, 500, 3)).cumsum(0).cumsum(1)
    noise = (255 * (noise - noise.min()) / np.ptp(noise)).astype(np.uint8)
    pictures = [noise[2 * i : 2 * i + 240, 3 * i : 3 * i + 320] for i in range(40)]
    write_film(tmp_path / "all.mp4", pictures, 30)
    os.sched_setaffinity(0, {min(cores)})
    try:
        write_film(tmp_path / "one.mp4", pictures, 30)
    finally:
        os.sched_setaffinity(0, cores)
    assert (tmp_path / "all.mp4").read_bytes() == (tmp_path / "one.mp4").read_bytes()
