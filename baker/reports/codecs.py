"""Every codec on one pack (SNeRG paper, section 7).

Each codec writes the pack anew, reads it back and is drawn by the OpenGL renderer: megabytes (10⁶ bytes) on disk,
PSNR, SSIM and LPIPS against the photographs, PSNR against the pictures of the pack as it was, seconds to encode and to
decode.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from console import UserError

# Each codec as it comes, and what places them on one curve.
LADDER: tuple[tuple[str, int | None], ...] = (
    ("png", None),
    ("webp", None),
    ("jpeg", 98),
    ("jpeg", None),
    ("jpeg", 90),
    ("h264", 92),
    ("h264", None),
    ("h264", 70),
    ("avif", 90),
    ("avif", None),
    ("avif", 70),
    ("avif", 60),
)
VIEWS, SIZE = 8, (400, 400)


def measured(
    path: Path,
    scene: Any,
    split: str,
    ladder: Sequence[tuple[str, int | None]],
    folder: Path,
    mask_of: Path | None = None,
) -> Iterator[dict[str, Any]]:
    """A row for each (codec, quality) of the ladder, written below `folder` and removed again. mask_of: see evaluate.

    Codecs whose library is missing are left out with a line on stderr.
    """
    from baker.reports.evaluation import evaluate
    from baker.reports.pack_compare import compare_packs, stored_bytes
    from scenepack import load_pack, save_pack
    from scenepack.codecs import chosen_quality, codec_named

    pack = load_pack(path)
    for name, asked in ladder:
        try:
            quality = chosen_quality(codec_named(name, "codec"), asked)
        except UserError as error:
            print(f"{name} is left out: {error}", file=sys.stderr)
            continue
        target = folder / "pack"
        encoding = time.perf_counter()
        save_pack(pack, target, codec=name, quality=quality)
        decoding = time.perf_counter()
        load_pack(target)
        done = time.perf_counter()
        shown = evaluate(target, scene, split, mask_of=mask_of)
        against = compare_packs(path, target, VIEWS, SIZE)
        yield {
            "codec": name,
            "quality": quality,
            "default": asked is None,
            "bytes": stored_bytes(target),
            "psnr": shown["psnr"],
            "ssim": shown["ssim"],
            "lpips": shown["lpips"],
            "psnr_against_pack": against["psnr"],
            "encode_s": decoding - encoding,
            "decode_s": done - decoding,
        }
