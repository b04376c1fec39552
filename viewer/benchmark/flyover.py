"""A flight around a pack without a window: a contact sheet and a film."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from console import progress
from console.atomic import replacing
from scenepack.pack import Pack
from viewer.features.film.film_export import films_possible, write_film
from viewer.rendering.framing import filling_orbit
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import RenderSettings

SHEET_COLUMNS, SHEET_ROWS, SHEET_SIDE = 4, 3, 400  # pictures and pixels
FILM_FRAMES, FILM_SIDE, FILM_FPS = 48, 320, 24
GAP = 8  # pixels between the sheet's pictures


def fly_over(pack: Pack, name: str, folder: Path, fov: float, settings: RenderSettings | None = None) -> list[Path]:
    """Renders one turn around `pack` offscreen; the files that were written, the contact sheet first.

    fov: vertical, degrees. The film is left out where PyAV is not installed. UserError where there is no OpenGL at all.
    """
    folder.mkdir(parents=True, exist_ok=True)
    film = films_possible()
    pictures = SHEET_COLUMNS * SHEET_ROWS
    frames = FILM_FRAMES if film else 0
    written = [folder / f"{name}-orbit.png"]
    with OffscreenRenderer(pack) as renderer, progress("rendering an orbit", pictures + frames) as bar:

        def flight(count: int, side: int) -> list[np.ndarray]:
            out = []
            for camera in filling_orbit(pack, count, fov, (side, side)):
                out.append(renderer.render(camera, settings))
                bar.advance()
            return out

        with replacing(written[0]) as new:
            contact_sheet(flight(pictures, SHEET_SIDE), SHEET_COLUMNS).save(new, format="PNG")
        if film:
            written.append(folder / f"{name}-orbit.mp4")
            write_film(written[1], flight(frames, FILM_SIDE), FILM_FPS)
    return written


def contact_sheet(pictures: list[np.ndarray], columns: int) -> Image.Image:
    """Pictures (uint8 [h, w, 3], all of one size) in rows of `columns`."""
    height, width = pictures[0].shape[:2]
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (columns * (width + GAP) + GAP, rows * (height + GAP) + GAP), (13, 17, 23))
    for i, picture in enumerate(pictures):
        place = GAP + i % columns * (width + GAP), GAP + i // columns * (height + GAP)
        sheet.paste(Image.fromarray(picture), place)
    return sheet
