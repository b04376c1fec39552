"""show: a scene in a window of its own, or in the notebook."""

import html
import importlib
import sys
from typing import Any

from snerg._errors import SnergError, with_snerg_errors
from snerg._scene import Scene

LARGEST_PAGE = 64 << 20  # bytes that a cell of a notebook may hold


@with_snerg_errors
def show(scene: Scene, *, size: tuple[int, int] = (960, 600)) -> None:
    """Shows a scene to fly through.

    In a notebook, below the cell: the web page of the scene in a frame of `size` pixels, or a picture where the pack is too large
    for a page. Elsewhere the viewer's window, until it is closed.

    Raises:
        SnergError: Where there is no display, or the viewer fails.
    """
    if _in_notebook():
        _display_in_cell(scene, size)
        return
    import subprocess

    from console.child_process import module_command
    from console.desktop import has_display

    if not has_display():
        raise SnergError("there is no display to show a window on", remedy="scene.render() gives pictures without one")

    words = ["--size", f"{size[0]}x{size[1]}"]
    done = subprocess.run(module_command("viewer.commands.view", str(scene.path.resolve()), *words), check=False)
    if done.returncode:
        raise SnergError("the viewer could not show it", where=scene.path, found=f"exit status {done.returncode}")


def _in_notebook() -> bool:
    """Whether this code runs in a cell of Jupyter."""
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return shell is not None and "IPKernelApp" in getattr(shell, "config", {})


def _display_in_cell(scene: Scene, size: tuple[int, int]) -> None:
    display = importlib.import_module("IPython.display")
    try:
        page = scene._page()
    except SnergError:
        page = b""
    if not 0 < len(page) <= LARGEST_PAGE:
        from PIL import Image

        display.display(Image.fromarray(scene.render(size=size)))
        return
    frame = (
        f'<iframe srcdoc="{html.escape(page.decode())}" width="{size[0]}" height="{size[1]}" style="border:0"></iframe>'
    )
    display.display(display.HTML(frame))
