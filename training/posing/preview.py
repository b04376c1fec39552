"""Preview of bare photographs before their poses are found: `python -m training.posing.preview SOURCE FOLDER`, for the viewer.

Small pictures go into FOLDER, lines of JSON to standard output as soon as they are known:
  {"count": pictures in all}
  {"name": as the user knows it, "file": of the small picture in FOLDER}      for each picture; of a film, for some frames
  {"aside": {name: why it would not be used}}                                 after the last picture
  {"seconds": {"pictures", "features", "matches", "poses"}}                   an estimate, from a few pictures that were timed
  {"error": one line}                                                         where it goes no further
It ends with its standard input.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from PIL import Image

from console import UserError, refusal
from console.child_process import json_answers
from training.posing.find import FRAMES
from training.posing.photograph import link_or_convert
from training.posing.prepare import choose, read_photographs
from training.scenes.pictures import small_picture
from training.scenes.sources import Source, find_source

SIDE = 160  # pixels of a small picture's longer side
PROBED = 3  # pictures whose features and matches are timed
GLIMPSES = 24  # of a film
# Time for adding a picture to the model, over that for its features: 0.2 to 1.3 in docs/results.md ("Poses of bare photographs").
POSES_BY_FEATURES = 0.5


def _photographs(
    source: Source, folder: Path, probes: Path, answer: Callable[..., None]
) -> tuple[list[str], int, float]:
    """Names of the pictures in `probes`, how many pictures would be used, and the seconds that preparing all takes."""
    answer(count=len(source.files))
    started, shown = time.monotonic(), 0.0

    def on_file(number: int, file: Path, readable: bool) -> None:
        nonlocal shown
        began, small = time.monotonic(), f"{number:05d}.jpg" if readable else ""
        if readable:
            small_picture(file, SIDE, "RGB").save(folder / small, format="JPEG", quality=85)
        answer(name=source.name_of(file), file=small)
        shown += time.monotonic() - began

    photographs, errors = read_photographs(source, on_file)
    seconds = time.monotonic() - started - shown
    chosen, aside = choose(source, photographs, errors)
    answer(aside=aside)
    first = max((len(chosen) - PROBED) // 2, 0)
    probed, started = chosen[first : first + PROBED], time.monotonic()  # that follow one another
    names = [link_or_convert(photograph, probes, str(i)) for i, photograph in enumerate(probed)]
    seconds += (time.monotonic() - started) / max(len(names), 1) * len(chosen)
    return names, len(chosen), seconds


def _film(source: Source, folder: Path, probes: Path, answer: Callable[..., None]) -> tuple[list[str], int, float]:
    """The same of a film."""
    from training.posing.film import glimpse

    film = source.files[0]
    names: list[str] = []

    def show(number: int, seconds: float, picture: Image.Image) -> None:
        small = f"{number:05d}.jpg"
        if len(names) < PROBED:
            names.append(small)
            picture.save(probes / small, quality=95)
        picture.thumbnail((SIDE, SIDE), Image.Resampling.BOX, reducing_gap=2.0)
        picture.save(folder / small, format="JPEG", quality=85)
        answer(name=f"{source.name_of(film)} at {seconds:.1f} s", file=small)

    count, decoding = glimpse(film, FRAMES, GLIMPSES, lambda frames: answer(count=frames), show)
    answer(aside={})
    return names, count, decoding


def _estimate(images: Path, names: Sequence[str], count: int, preparing: float, answer: Callable[..., None]) -> None:
    """Estimates the seconds of all pictures from a few that are timed; nothing where pycolmap is not installed."""
    try:
        from training.posing.mapping import how_many_pairs, measured
    except ModuleNotFoundError:
        return
    if len(names) < 2:
        return
    features, matches = measured(images, names)
    each = features / len(names)
    answer(seconds={
        "pictures": preparing, "features": each * count,
        "matches": matches / how_many_pairs(len(names)) * how_many_pairs(count), "poses": POSES_BY_FEATURES * each * count,
    })  # fmt: skip


def main() -> int:
    """Entry point; returns the exit status."""
    answer = json_answers()
    try:
        source = find_source(Path(sys.argv[1]))
        if source is not None:
            show = _film if source.kind == "film" else _photographs
            with tempfile.TemporaryDirectory(prefix="snerg-preview-") as probes:
                names, count, seconds = show(source, Path(sys.argv[2]), Path(probes), answer)
                _estimate(Path(probes), names, count, seconds, answer)
        return 0
    except Exception as error:
        line = str(error) if isinstance(error, UserError) else refusal(error)
        if line is None:
            raise
        answer(error=line)
        return 2


if __name__ == "__main__":
    sys.exit(main())
