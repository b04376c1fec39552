"""The pixels of many photographs as one array of bytes, in memory or, where they are too many, in a file.

Notation: photographs lie end to end, row by row; of each, one row in `row_step` is taken. C channels: 3, or 4 with alpha.
"""

import os
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from console import UserError
from console.memory import free_memory
from training.scenes.files import notice
from training.scenes.pictures import PictureLoader, as_bytes
from training.scenes.scene import Camera, Photograph

FILE_SHARE = 3  # pixels that take more than this part of the free memory, a third, go to a file
DECODING = 24  # bytes for each pixel of a photograph while it is decoded
ASSUMED_FREE = 4 << 30  # bytes, where the system does not tell
TOGETHER = 1 << 24  # pixels that are moved at once
ALIGNED = 64  # bytes: where arrays begin that JAX takes over on a processor (jnp.asarray) without copying them


def pixel_counts(cameras: Sequence[Camera], row_step: int = 1) -> np.ndarray:
    """int64 [V]: how many pixels are taken of each photograph."""
    return np.array([c.width * -(-c.height // row_step) for c in cameras], np.int64)


def may_be_transparent(photographs: Sequence[Photograph]) -> bool:
    """Whether any may have alpha below 1, as far as headers tell. UserError where a picture is missing."""
    loaders = (photograph.load for photograph in photographs)
    return any(not isinstance(load, PictureLoader) or load.may_be_transparent() for load in loaders)


def load_pixels(
    photographs: Sequence[Photograph], first: int = 0, last: int | None = None, *,
    channels: int = 4, row_step: int = 1, folder: Path | None = None,
) -> np.ndarray:  # fmt: skip
    """Pixels uint8 [last - first, C] of photographs of any sizes.

    Decodes only photographs with a pixel in [first, last), in threads; beyond the last pixel all is 0. With 3 channels, alpha
    is left out. folder: where a file without a name is made, if needed. A notice names masks that hide or show everything.
    UserError where a picture fails to decode, or the disk is full.
    """
    sizes = pixel_counts([p.camera for p in photographs], row_step)
    starts = np.cumsum(sizes) - sizes
    last = int(sizes.sum()) if last is None else last
    pixels = _zeros((last - first) * channels, folder).reshape(-1, channels)
    masks: dict[str, tuple[int, int]] = {}

    def decode(index: int) -> None:
        photograph, start = photographs[index], int(starts[index])
        load = photograph.load
        picture = load.pixels() if isinstance(load, PictureLoader) else as_bytes(load())
        if isinstance(load, PictureLoader) and load.mask is not None:
            masks[photograph.name] = (picture[..., 3].min(), picture[..., 3].max())
        rows = picture[::row_step].reshape(-1, picture.shape[-1])
        low, high = max(first, start), min(last, start + len(rows))
        there, rows = pixels[low - first : high - first], rows[low - start : high - start]
        shared = min(channels, rows.shape[-1])
        there[:, :shared] = rows[:, :shared]
        there[:, shared:] = 255

    needed = np.nonzero((starts < last) & (starts + sizes > first))[0]
    with ThreadPoolExecutor(_at_once(photographs)) as pool:
        list(pool.map(decode, needed))
    notice_masks(None, masks)
    return pixels


def notice_masks(where: Path | None, extremes: Mapping[str, tuple[int, int]]) -> None:
    """Says which masks hide or show everything, of the smallest and largest values of all by name."""
    hiding = sorted(name for name, (_, high) in extremes.items() if high == 0)
    showing = sorted(name for name, (low, _) in extremes.items() if low == 255)
    for does, names in (("hide", hiding), ("show", showing)):
        notice(where, f"{len(names)} of {len(extremes)} masks {does}{'s' * (len(names) == 1)} everything", names)


def without_alpha(pixels: np.ndarray) -> np.ndarray:
    """Pixels uint8 [N, 3] of [N, 4], in the same memory."""
    flat = pixels.reshape(-1)
    for low in range(0, len(pixels), TOGETHER):
        some = pixels[low : low + TOGETHER, :3].copy()
        flat[3 * low : 3 * low + some.size] = some.reshape(-1)
    return flat[: 3 * len(pixels)].reshape(-1, 3)


def _at_once(photographs: Sequence[Photograph]) -> int:
    """How many photographs are decoded at once: as many as there are processors for, and a quarter of the free memory holds."""
    sizes = [(p.camera.width, p.camera.height) for p in photographs]
    sizes += [p.load.source_size for p in photographs if isinstance(p.load, PictureLoader)]
    largest = max(width * height for width, height in sizes)
    return max(1, min(16, (os.cpu_count() or 1) + 2, (free_memory() or ASSUMED_FREE) // 4 // (DECODING * largest)))


def _zeros(size: int, folder: Path | None) -> np.ndarray:
    """uint8 [size] zeros, in memory or in a file without a name."""
    if size <= (free_memory() or ASSUMED_FREE) // FILE_SHARE:
        memory = np.zeros(size + ALIGNED, np.uint8)
        start = -memory.ctypes.data % ALIGNED
        return memory[start : start + size]
    failure, places = OSError(), [*([folder] if folder else []), Path(tempfile.gettempdir())]
    for place in places:
        try:
            place.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=place) as file:
                if hasattr(os, "posix_fallocate"):  # a disk that is full later kills who writes to mapped memory
                    os.posix_fallocate(file.fileno(), 0, size)
                return np.asarray(np.memmap(file, np.uint8, "r+", shape=(size,)))
        except OSError as error:
            failure = error
    remedy = "free some space there, name another folder by TMPDIR, or use --downscale 2"
    raise UserError("the photographs fit neither in memory nor on this disk", where=" and ".join(map(str, places)),
                    expected=f"{size / 1e9:.1f} GB of free space", found=failure.strerror or str(failure),
                    remedy=remedy) from failure  # fmt: skip
