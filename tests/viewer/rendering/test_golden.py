"""Pictures as they have always been, on llvmpipe. After a wanted change: pytest tests/viewer/rendering/test_golden.py
--regenerate-golden, and look at each picture that git shows as changed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from scenepack.pack import Pack
from tests.viewer.rendering import pictures
from tests.viewer.rendering.golden_variants import (
    CONTRACTED_VARIANTS,
    GOLDEN,
    NDC_VARIANTS,
    VARIANTS,
    all_variants,
    camera_for,
    settings_of,
)
from tests.viewer.rendering.pictures import compare_with_golden
from viewer.rendering.offscreen import OffscreenRenderer
from viewer.rendering.settings import MODES, RenderSettings

Make = Callable[..., OffscreenRenderer]


@pytest.fixture
def golden(request: pytest.FixtureRequest, offscreen: Make) -> Callable[..., None]:
    def compare(name: str, pack: Pack, wanted: RenderSettings) -> None:
        renderer = offscreen(pack, wanted.marcher)
        picture = renderer.render(camera_for(pack), wanted)
        assert picture.std() > 5, "there is nothing to see"
        compare_with_golden(request.config, renderer.ctx.info["GL_RENDERER"], name, picture)

    return compare


@pytest.mark.parametrize("mode", MODES)
def test_each_display_mode_looks_as_before(golden: Callable[..., None], shapes: Pack, mode: str) -> None:
    golden(mode, shapes, settings_of(mode))


@pytest.mark.parametrize("name", VARIANTS)
def test_each_variant_looks_as_before(golden: Callable[..., None], shapes: Pack, name: str) -> None:
    golden(name, shapes, VARIANTS[name])


@pytest.mark.parametrize("name", NDC_VARIANTS)
def test_forward_facing_packs_look_as_before(golden: Callable[..., None], ndc_shapes: Pack, name: str) -> None:
    golden(name, ndc_shapes, NDC_VARIANTS[name])


@pytest.mark.parametrize("name", CONTRACTED_VARIANTS)
def test_contracted_packs_look_as_before(golden: Callable[..., None], surroundings: Pack, name: str) -> None:
    golden(name, surroundings, CONTRACTED_VARIANTS[name])


def test_no_golden_picture_is_left_over() -> None:
    known = {name for name, _, _ in all_variants()}
    assert {path.stem for path in GOLDEN.glob("*.png")} <= known


def test_a_changed_picture_fails_and_leaves_what_is_needed_to_see_why(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    if request.config.getoption("--regenerate-golden"):
        pytest.skip("pictures are being rewritten")
    monkeypatch.setattr(pictures, "FAILURES", tmp_path)
    changed = np.asarray(Image.open(GOLDEN / "normal.png").convert("RGB")).copy()
    changed[60:80, 60:80] //= 2
    with pytest.raises(pytest.fail.Exception, match="FLIP"):
        compare_with_golden(request.config, "llvmpipe", "normal", changed)
    assert {path.name.split("-", 1)[1] for path in tmp_path.iterdir()} == {
        "actual.png",
        "expected.png",
        "difference-x8.png",
    }
