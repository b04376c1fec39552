"""Opening many packs leaves nothing behind: neither in our memory nor on the card.

On the software rasteriser textures lie in the process's own memory, so that one forgotten shows there as well.
"""

import gc
import shutil
from pathlib import Path

import pytest

from scenepack import save_pack
from tests.viewer.shapes import shapes_pack
from viewer.panels.offscreen_ui import OffscreenUi

TOLERATED = 0.02
WARM_UP, PACKS = 25, 50  # allocators keep some for later, threads get arenas of their own, in steps


def resident_bytes() -> int:
    gc.collect()
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


@pytest.fixture(scope="module")
def on_disk(tmp_path_factory) -> list[Path]:
    """A folder, a zip and a diffuse pack, of different sizes."""
    folder = tmp_path_factory.mktemp("many")
    save_pack(shapes_pack(84), folder / "a")
    save_pack(shapes_pack(70), folder / "b")
    save_pack(shapes_pack(70, diffuse=True), folder / "c")
    shutil.make_archive(str(folder / "b"), "zip", folder / "b")
    return [folder / "a", folder / "b.zip", folder / "c"]


def open_and_look(ui: OffscreenUi, path: Path, *, other: bool = False) -> None:
    """Opens a pack from disk as a user does, and draws it."""
    ui.app.open(path, other=other)
    ui.app.loading.wait(30)
    for _ in range(4):
        ui.frame()
    assert ui.app.scene is not None and not ui.app.messages.dialogs


def test_fifty_packs_opened_from_disk_and_closed_leave_memory_where_it_was(offscreen, app, on_disk):
    ui = offscreen(app, size=(480, 360))
    app.governor.enabled = False

    def open_and_close(times: int) -> list[int]:
        told = []
        for i in range(times):
            open_and_look(ui, on_disk[i % 3])
            if i % 10 == 4:
                open_and_look(ui, on_disk[(i + 1) % 3], other=True)
            app.close()
            ui.frame()
            ui.frame()
            told.append(resident_bytes())
        return told

    open_and_close(WARM_UP)
    card, host = ui.canvas.gpu_bytes, resident_bytes()
    told = open_and_close(PACKS)
    assert ui.canvas.gpu_bytes == card
    grown = told[-1] / host - 1
    print(f"{host / 2**20:.1f} MiB before, {told[-1] / 2**20:.1f} MiB after {PACKS} packs ({100 * grown:+.2f} %)")
    assert abs(grown) < TOLERATED, " ".join(f"{bytes_ / 2**20:.1f}" for bytes_ in (host, *told))
    assert ui.ctx.error == "GL_NO_ERROR"


def test_one_pack_forgotten_in_fifty_would_be_noticed(on_disk):
    """That the bound above is a bound: what the smallest pack takes, forgotten every time, is far beyond it."""
    from scenepack import load_pack

    pack = load_pack(on_disk[2])
    assert PACKS * pack.atlas_rgba.nbytes > 4 * TOLERATED * resident_bytes()
