"""Pictures as they have always been, on llvmpipe. After a wanted change: pytest tests/viewer/rendering/test_golden.py
--regenerate-golden, and look at each picture that git shows as changed.
"""

from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from scenepack import Pack
from tests.viewer.rendering import pictures
from tests.viewer.rendering.golden_variants import GOLDEN, VARIANTS, camera_for
from tests.viewer.rendering.pictures import compare_with_golden
from viewer.rendering.offscreen import OffscreenRenderer

Make = Callable[[Pack], OffscreenRenderer]


@pytest.mark.parametrize("name", VARIANTS)
def test_each_picture_looks_as_before(request: pytest.FixtureRequest, offscreen: Make, name: str) -> None:
    pack, wanted = VARIANTS[name]
    renderer = offscreen(request.getfixturevalue(pack))
    picture = renderer.render(camera_for(renderer.pack), wanted)
    assert picture.std() > 5, "there is nothing to see"
    compare_with_golden(request.config, renderer.ctx.info["GL_RENDERER"], name, picture)


def test_no_golden_picture_is_left_over() -> None:
    assert {path.stem for path in GOLDEN.glob("*.png")} <= set(VARIANTS)


def test_a_changed_picture_fails_and_leaves_what_is_needed_to_see_why(request, monkeypatch, tmp_path):
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
