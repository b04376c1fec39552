"""Opening many packs leaves nothing behind."""

import gc

from tests.window.conftest import toy_pack


def resident_bytes() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


def test_fifty_packs_leave_memory_where_it_was(offscreen, app, pack_folder):
    ui = offscreen(app, size=(600, 420))
    packs = [toy_pack(seed=i, view_mlp=i % 2 == 0) for i in range(2)]

    def open_and_close(times: int) -> None:
        for i in range(times):
            app.show(packs[i % 2], pack_folder)
            ui.frame()
            ui.frame()
        app.close()
        ui.frame()
        gc.collect()

    open_and_close(10)  # drivers and allocators keep some for later
    card, host = ui.canvas.gpu_bytes, resident_bytes()
    open_and_close(50)
    assert ui.canvas.gpu_bytes == card
    assert resident_bytes() < 1.02 * host + (2 << 20)
    assert ui.ctx.error == "GL_NO_ERROR"
