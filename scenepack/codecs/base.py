"""What the codecs have in common: they store pieces of the atlas in a layout of their own choice (scenepack.piece_files)."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar, Literal

import numpy as np

from scenepack.constants import PLANES_PER_IMAGE

Layout = Literal["atlas", "grid"]
Shape = tuple[int, int, int]  # planes, rows, columns
Parts = list[np.ndarray]  # of a piece: rgba and, where there are any, features, uint8 [D, H, W, 4] each


class CodecError(Exception):
    """Bytes that cannot be decoded; the message is the reason, without the file's name.

    file: which of several it is, None where it is the only one.
    """

    file: str | None = None


@contextmanager
def decoding(file: str | None = None) -> Iterator[None]:
    """Whatever goes wrong inside is a CodecError, of `file`: the libraries raise dozens of unrelated types."""
    try:
        yield
    except CodecError as error:
        error.file = error.file or file
        raise
    except MemoryError:
        raise
    except Exception as error:
        refused = CodecError(" ".join(str(error).split())[:200] or type(error).__name__)
        refused.file = file
        raise refused from error


class Codec(ABC):
    """One way to store pieces. Its methods run in several threads."""

    name: ClassVar[str]  # the JSON's "format"
    layout: ClassVar[Layout]  # how it likes the atlas cut
    default_quality: ClassVar[int | None] = None  # 1 (worst) to 100, None where nothing is ever lost
    header_bytes: ClassVar[int]  # of a file, enough for `check`

    def require(self) -> None:
        """UserError, with what to install, where a library that it needs is missing."""
        return

    def planes(self, layout: Layout, block_size: int) -> int:
        """How many planes it likes in a piece; in the "grid" layout a multiple of block_size."""
        return block_size if layout == "grid" else PLANES_PER_IMAGE

    @abstractmethod
    def names(self, number: int, shape: Shape, features: bool) -> tuple[str, ...]:
        """The files of piece `number`; those without features come first."""

    def check(self, name: str, head: bytes, shape: Shape) -> None:
        """CodecError where a file's first header_bytes tell that it cannot hold this piece."""
        raise NotImplementedError

    @abstractmethod
    def encode(self, parts: Parts, quality: int) -> tuple[bytes, ...]:
        """The contents of `names`, in their order."""

    def decode(self, files: dict[str, bytes], names: tuple[str, ...], shape: Shape, features: bool) -> Parts:
        """The parts back from `files`. CodecError where it cannot."""
        raise NotImplementedError


def in_few_levels(features: np.ndarray) -> bool:
    """Whether features take a quarter of their range at most, as bakes store them: codecs with loss code these as much finer."""
    return int(features.max(initial=0)) <= 64


def cut_off(data: bytes) -> CodecError:
    """For a file that ends before its header does."""
    return CodecError("the file is empty" if not data else f"the file ends after {len(data)} bytes")
