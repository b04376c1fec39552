"""Pictures as they have always been, on llvmpipe. After a wanted change: pytest tests/viewer/rendering/test_golden.py
--regenerate-golden, and look at each picture that git shows as changed.
"""

import pytest

from tests.viewer.rendering.golden_variants import GOLDEN, VARIANTS, camera_for
from tests.viewer.rendering.pictures import compare_with_golden


@pytest.mark.parametrize("name", VARIANTS)
def test_each_picture_looks_as_before(request: pytest.FixtureRequest, offscreen, name: str) -> None:
    pack, wanted = VARIANTS[name]
    renderer = offscreen(request.getfixturevalue(pack))
    picture = renderer.render(camera_for(renderer.pack), wanted)
    assert picture.std() > 5, "there is nothing to see"
    compare_with_golden(request.config, renderer.ctx.info["GL_RENDERER"], name, picture)


def test_no_golden_picture_is_left_over() -> None:
    assert {path.stem for path in GOLDEN.glob("*.png")} <= set(VARIANTS)
