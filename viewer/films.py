"""MP4 films, where PyAV is installed (the extra `video`)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from console import UserError


def require_video() -> None:
    """UserError, with the remedy, where PyAV is not installed."""
    try:
        import av  # noqa: F401
    except ImportError as error:
        raise UserError("writing an .mp4 needs PyAV", remedy="pip install 'snerg[video]', or name a folder") from error


def write_film(path: Path, pictures: Iterable[np.ndarray], fps: int) -> None:
    """Encodes pictures (uint8 [h, w, 3], all of one size) as H.264; an odd last row or column is cut off.

    The file appears when it is complete.
    """
    require_video()
    import av

    aside = path.with_name(f".{path.name}.part.mp4")
    try:
        with av.open(str(aside), "w") as container:
            stream = None
            for picture in pictures:
                picture = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
                if stream is None:
                    stream = container.add_stream("libx264", rate=fps, options={"crf": "18", "preset": "veryfast"})
                    stream.height, stream.width = picture.shape[:2]
                    stream.pix_fmt = "yuv420p"
                frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
                container.mux(stream.encode(frame))
            if stream is not None:
                container.mux(stream.encode())
        aside.replace(path)
    finally:
        aside.unlink(missing_ok=True)
