"""`python -m tools.page_report PACK PAGE`: a web page beside the desktop: pictures, time to open and memory.

PAGE is what `snerg-pack export` made of PACK, one file. Needs Chromium. Opening alternates between the two, and is in seconds of
processor time of all their processes as well, which other work changes less.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import tyro
from PIL import Image

from console import run_command
from scenepack import Pack, load_pack
from tests.viewer.web.browser import Browser
from tests.viewer.web.conftest import page_picture
from viewer.rendering.camera import ViewCamera, forward_facing_path
from viewer.rendering.offscreen import OffscreenRenderer

SIZE = (400, 300)
ORBIT = ((205, 22, None), (20, 60, 3.0), (120, -10, 1.5), (300, 8, 1.2))  # azimuth, elevation, distance
PATIENCE_S = 1800.0
TICKS = os.sysconf("SC_CLK_TCK")
DESKTOP = "import sys; from snerg_commands import view; sys.argv[0] = 'snerg-view'; sys.exit(view())"


def cameras_of(pack: Pack) -> list[ViewCamera]:
    """Four that see the pack."""
    if pack.ndc:
        return list(forward_facing_path(pack, len(ORBIT), size=SIZE))
    return [ViewCamera.orbit(pack, azimuth, up, distance, size=SIZE) for azimuth, up, distance in ORBIT]


def compare(pack: Pack, page: Path, browser: Browser, out: Path | None) -> None:
    """Prints, for each camera, the share of channels that differ by more than 2/255, and the largest difference."""
    with OffscreenRenderer(pack) as renderer:
        expected = [renderer.render(camera) for camera in cameras_of(pack)]
    for number, (camera, desktop) in enumerate(zip(cameras_of(pack), expected, strict=True)):
        shown = page_picture(browser, camera)
        difference = np.abs(shown.astype(int) - desktop)
        print(f"camera {number}: {100 * np.mean(difference > 2):.4f} %, at most {difference.max()}/255", flush=True)
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.concatenate([shown, desktop], 1)).save(out / f"{page.stem}-{number}.png")


def processes(group: int) -> tuple[float, float]:
    """Of a group of processes: seconds of processor time, and the most memory, MB, that one that shows a page has held."""
    seconds, most = 0.0, 0.0
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(fields[2]) != group:
                continue
            seconds += (int(fields[11]) + int(fields[12])) / TICKS
            if b"--type=renderer" in (folder / "cmdline").read_bytes():
                status = (folder / "status").read_text().partition("VmHWM:")[2].split()
                most = max(most, int(status[0]) / 1e3)
        except (OSError, IndexError):
            continue  # has ended meanwhile
    return seconds, most


def open_page(browser: Browser, page: Path, start: float) -> str:
    """Opens the page; the time since `start`, when the browser began to, and memory."""
    _, empty = processes(browser.group)
    browser.open(page.resolve().as_uri())
    browser.evaluate("snerg.ready.then(() => true)")
    wall, (busy, most) = time.perf_counter() - start, processes(browser.group)
    atlas = browser.evaluate("snerg.level.atlas.size.reduce((a, n) => a * n, 4)") / 1e6
    return f"page {wall:.1f} s, processor {busy:.1f} s; memory {most - empty:.0f} MB, of which {atlas:.0f} MB are the atlas"


def open_desktop(pack: Path) -> str:
    """Starts the viewer with the pack, which ends once it is shown; how long that took."""
    start, before = time.perf_counter(), os.times()
    with tempfile.TemporaryDirectory() as folder:
        command = ["xvfb-run", "-a", sys.executable, "-c", DESKTOP, str(pack), "--screenshot", f"{folder}/a.png"]
        subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    wall, after = time.perf_counter() - start, os.times()
    busy = after.children_user + after.children_system - before.children_user - before.children_system
    return f"desktop {wall:.1f} s, processor {busy:.1f} s"


def page_report(
    pack: tyro.conf.Positional[Path], page: tyro.conf.Positional[Path], rounds: int = 3, out: Path | None = None
) -> None:
    """Measures a web page beside the desktop.

    Args:
        pack: The pack that the page shows.
        page: What `snerg-pack export` made of it, one file.
        rounds: Times that both are opened.
        out: Folder for pictures: the page's beside the desktop's.
    """
    for number in range(rounds + 1):
        start = time.perf_counter()
        with tempfile.TemporaryDirectory() as profile, Browser(Path(profile), (800, 600)) as browser:
            browser.patience_s = PATIENCE_S
            print(open_page(browser, page, start), flush=True)
            if number == rounds:
                compare(load_pack(pack), page, browser, out)
                break
        print(open_desktop(pack), flush=True)


if __name__ == "__main__":
    sys.exit(run_command(page_report, prog="python -m tools.page_report"))
