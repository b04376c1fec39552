"""The page draws what the desktop draws, in every mode, of packs of every kind."""

from dataclasses import replace

import numpy as np
import pytest

from scenepack import load_pack
from tests.viewer.rendering.golden_variants import PACKS, camera_for
from tests.viewer.rendering.shapes import shapes_pack
from tests.viewer.web.conftest import page_picture
from viewer.core.annotations import KEY, Annotations, annotations_to_json
from viewer.features.display.display import backdrop
from viewer.rendering.camera import ViewCamera
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import Look, Mode, RenderSettings
from viewer.web.description import MODES

SIZE = (160, 120)
DIFFERS, SHARE = 2, 0.001  # of 255; of the channels that may differ by more
WHITE = "background: [1, 1, 1]"


def assert_same(page: np.ndarray, desktop: np.ndarray, what: str) -> None:
    difference = np.abs(page.astype(int) - desktop)
    share = float(np.mean(difference > DIFFERS))
    assert share <= SHARE, f"{what}: {100 * share:.3f} % of the channels differ, the worst by {difference.max()}/255"
    assert len(np.unique(page)) > 3, f"{what}: nothing is seen"


@pytest.mark.slow
def test_the_demo_looks_the_same_from_four_cameras(show, demo) -> None:
    pack = load_pack(demo)
    browser = show(pack)
    assert not browser.problems
    with OffscreenRenderer(pack) as desktop:
        for azimuth, elevation, distance in ((205, 22, None), (20, 60, 3.0), (120, -10, 1.5), (300, 8, 0.4)):
            camera = ViewCamera.orbit(pack, azimuth, elevation, distance, size=SIZE)
            assert_same(page_picture(browser, camera), desktop.render(camera), f"azimuth {azimuth}")


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PACKS, "diffuse"])
def test_every_mode_of_every_kind_of_pack_looks_the_same(name: str, show) -> None:
    pack = shapes_pack(diffuse=True) if name == "diffuse" else PACKS[name]()
    browser, camera = show(pack), camera_for(pack).resized(*SIZE)
    modes: list[Mode] = [
        mode for mode in MODES if pack.view_mlp is not None or mode not in ("features", "view-dependent")
    ]
    assert browser.evaluate("Object.keys(snerg.scene.shaders.modes)") == modes
    gradient = backdrop("gradient", "dark")
    cases = [
        *((camera, f"mode: '{mode}', {WHITE}", RenderSettings(mode=mode)) for mode in modes),
        (camera, "background: [0.1, 0.2, 0.3]", RenderSettings(background=(0.1, 0.2, 0.3))),
        (camera, "background: null", RenderSettings(backdrop=gradient)),
    ]
    if not pack.ndc:
        cases.append((replace(camera, near=2.6), WHITE, RenderSettings()))
    if pack.contraction is not None:
        cases.append((camera, f"surroundings: false, {WHITE}", RenderSettings(surroundings=False)))
    with OffscreenRenderer(pack) as desktop:
        for seen, settings, wanted in cases:
            page = page_picture(browser, seen, f"{{{settings}}}")
            assert_same(page, desktop.render(seen, wanted), f"{name}, {settings}")
        look = Look(0.7, 0.4, -0.2, 1.3)
        again = show(pack.with_metadata(**{KEY: annotations_to_json(Annotations(look=look))}))
        for mode in ("normal", "depth"):
            page = page_picture(again, camera, f"{{mode: '{mode}', {WHITE}}}")
            expected = desktop.render(camera, RenderSettings(mode=mode, look=look))
            assert_same(page, expected, f"{name}, {mode} with a look")
    assert not browser.problems
