"""Sharing serves the open pack as a page, with the view, the crop and the camera path of the moment, until it is stopped."""

import base64
import json
import re
import zlib
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

import numpy as np
import pytest

from console import UserError
from scenepack import Pack
from tests.viewer.waiting import until
from viewer.app.application import App


def shared(app: App, address: str) -> dict:
    with urlopen(address, timeout=20) as answer:
        packed = re.search(rb'id="scene">([^<]*)<', answer.read())
    assert packed is not None
    return json.loads(zlib.decompress(base64.b64decode(packed[1])))


@pytest.mark.slow
def test_the_scene_is_shared_as_it_is_seen_until_that_is_stopped(app: App, pack: Pack, pack_folder: Path) -> None:
    app.show(pack, pack_folder)
    assert app.scene is not None
    app.scene.rig.turn(30, 10)
    app.scene.rig.shown = app.scene.rig.goal
    app.filming.turntable(app)
    app.set(crop=((-1.0, -1.0, -1.0), (0.0, 1.0, 1.0)))
    app.sharing.start(app)
    server = app.sharing.server
    assert server is not None and server.folder.is_dir()
    try:
        until(lambda: app.sharing.tick(app) or server.address != "")
        scene = shared(app, server.address)
        assert scene["title"] == app.scene.name and scene["path"]["frames"]
        assert scene["levels"][-1]["box"][1][0] == pytest.approx(0.5 * pack.grid_size[0], abs=1)
        home, goal = scene["camera"]["home"], app.scene.rig.goal
        assert np.isclose(home["azimuth"] % 360, goal.azimuth % 360) and np.isclose(home["elevation"], goal.elevation)
        app.sharing.copy(app)
        assert app.clipboard.text == server.address
    finally:
        app.sharing.end()
    assert app.sharing.server is None and not server.folder.exists()
    with pytest.raises(URLError):
        urlopen(server.address, timeout=20)


def test_what_cannot_be_shared_is_told(app: App, pack: Pack, pack_folder: Path, tmp_path: Path) -> None:
    assert not app.run("share")  # nothing is open
    assert app.sharing.server is None
    app.show(pack, tmp_path / "gone")
    with pytest.raises(UserError, match="not a pack on disk"):
        app.sharing.start(app)
    app.show(pack, pack_folder)
    app.sharing.start(app)
    server = app.sharing.server
    assert server is not None
    server.child.kill()
    until(lambda: app.sharing.tick(app) or app.sharing.server is None)
    assert "is not shared" in app.messages.dialogs[0].title and not server.folder.exists()
