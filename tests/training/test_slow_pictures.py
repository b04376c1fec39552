"""A photograph whose decoding would take hours is refused, in the program itself, before it begins."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from console import UserError
from training.scenes.picture_headers import SCAN
from training.scenes.pictures import PictureLoader, read_picture

SIZE = (64, 48)


def progressive(more: int) -> bytes:
    """A progressive JPEG that goes over its pixels so many times more than it has to, 31 bytes each time."""
    file = io.BytesIO()
    Image.new("RGB", SIZE, (200, 100, 50)).save(file, "JPEG", progressive=True)
    whole, end = file.getvalue()[:-2], file.getvalue()[-2:]
    return whole + whole[whole.rindex(SCAN) :] * more + end


def test_a_jpeg_of_many_scans_is_refused_by_all_that_decodes(tmp_path: Path) -> None:
    picture = tmp_path / "r_0.png"
    picture.write_bytes(progressive(200))
    load = PictureLoader(picture, SIZE, SIZE)
    for decode in (lambda: read_picture(picture), load, load.pixels, lambda: load.thumbnail(8)):
        with pytest.raises(UserError, match=r"r_0\.png: the picture cannot be decoded.*it has 2\d\d scans"):
            decode()


@pytest.mark.parametrize("more", [0, 50])
def test_progressive_photographs_are_decoded(tmp_path: Path, more: int) -> None:
    (tmp_path / "r_0.jpg").write_bytes(progressive(more))
    np.testing.assert_allclose(read_picture(tmp_path / "r_0.jpg")[..., 0], 200 / 255, atol=0.02)
