"""Serves the page of a pack until it is interrupted; of a run that trains, its newest preview, and in the end its pack."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from console import UserError
from scenepack.pack import Pack
from scenepack.reader import load_pack
from viewer.core.files import kind_of, pack_in
from viewer.core.state import name_of
from viewer.features.making.make_job import TrainingPreviewFile
from viewer.features.making.make_plan import PREVIEW_FILE
from viewer.web.description import PageContent
from viewer.web.page import INDEX, scene_files, scene_page
from viewer.web.server import PageServer

LOOK_EVERY_S = 1.0  # for a newer preview
WAITING = b"""<!doctype html><html lang="en"><head><meta charset="utf-8"><meta http-equiv="refresh" content="2">
<title>Training</title>
<style>body{font:16px system-ui;background:#0d1117;color:#e6ebf2;display:grid;place-items:center;height:90vh}</style></head>
<body><p>Waiting for the first preview of the training.</p></body></html>"""
ContentOf = Callable[[Pack, Path], PageContent]  # of a pack, and where it is
LiveContentOf = Callable[[Pack, str], PageContent]  # of a preview, and its name


def serve(path: Path, host: str, port: int, content: ContentOf, live: LiveContentOf) -> None:
    """Prints the address and serves. path: a pack, or a run. UserError for anything else."""
    kind = kind_of(path)
    if kind not in ("pack", "run"):
        raise UserError("is no pack and no run", where=path, remedy="name one: snerg-view PACK --serve")
    if kind == "pack":
        path = pack_in(path)
        pack = load_pack(path)
        files = scene_files(pack, content(pack, path))
    else:
        files = {INDEX: WAITING}
    ended = threading.Event()
    with PageServer(files, host, port) as server:
        print(f"{server.address}\nCtrl-C ends it.", flush=True)
        if kind == "run":
            threading.Thread(target=_follow, args=(server, path, content, live, ended), daemon=True).start()
        try:
            server.serve_forever()
        finally:
            ended.set()


def _follow(server: PageServer, run: Path, content: ContentOf, live: LiveContentOf, ended: threading.Event) -> None:
    """Serves each newer preview, as one file, so that no page is of two; the pack once it is there."""
    folder = run.parent if (run / "config.json").is_file() else run
    preview, pack = TrainingPreviewFile(folder / PREVIEW_FILE), folder / "pack"
    while not ended.wait(LOOK_EVERY_S):
        try:
            if pack.is_dir() and kind_of(pack) == "pack":
                loaded = load_pack(pack)
                server.files = scene_files(loaded, content(loaded, pack))
                return
            newer = preview.poll()
            if newer is not None:
                server.files = {
                    INDEX: scene_page(newer.pack, live(newer.pack, f"{name_of(folder)}: {newer.description}"))
                }
        except UserError as error:  # a preview that cannot be shown; the next may
            print(f"snerg-view: warning: {error}", flush=True)
