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


def test_a_mask_may_take_no_longer(tmp_path: Path) -> None:
    picture, mask = tmp_path / "r_0.png", tmp_path / "mask.png"
    picture.write_bytes(progressive(0))
    mask.write_bytes(progressive(200))
    load = PictureLoader(picture, SIZE, SIZE, mask)
    for decode in (load, lambda: load.thumbnail(8)):
        with pytest.raises(UserError, match=r"it has 2\d\d scans"):
            decode()


def test_scans_are_counted_wherever_a_file_is_cut_into_blocks(tmp_path: Path) -> None:
    whole = progressive(95)
    at = whole.rindex(SCAN)
    comment = b"\xff\xfe" + (65000).to_bytes(2, "big") + bytes(64998)
    lead = (1 << 20) - 1 - at  # so that the last scan's two bytes lie in two blocks
    pieces, rest = divmod(lead, len(comment))
    padding = comment * pieces + b"\xff\xfe" + (rest - 2).to_bytes(2, "big") + bytes(rest - 4)
    picture = tmp_path / "r_0.jpg"
    picture.write_bytes(whole[:2] + padding + whole[2:])
    assert picture.read_bytes()[(1 << 20) - 1 :][:2] == SCAN
    with pytest.raises(UserError, match=f"it has {whole.count(SCAN)} scans"):
        read_picture(picture)


@pytest.mark.parametrize("more", [0, 50])
def test_progressive_photographs_are_decoded(tmp_path: Path, more: int) -> None:
    (tmp_path / "r_0.jpg").write_bytes(progressive(more))
    np.testing.assert_allclose(read_picture(tmp_path / "r_0.jpg")[..., 0], 200 / 255, atol=0.02)
