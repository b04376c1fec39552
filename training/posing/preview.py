"""What is asked about bare photographs before anything is begun: which there are, which would be set aside and why, and how long
finding their poses takes on this computer. `python -m training.posing.preview SOURCE FOLDER`, for programs such as the viewer.

Small pictures go into FOLDER. Lines of JSON go to standard output as they are known:
  {"count": pictures in all}
  {"name": as the user knows it, "file": of the small picture in FOLDER}      for each picture; of a film, for some frames
  {"aside": {name: why}}                                                      once all were looked at
  {"seconds": {"pictures", "features", "matches", "poses"}}                   an estimate, from a few pictures that were timed
  {"error": one line}                                                         where it goes no further
It ends with its standard input.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from console import UserError, refusal
from training.posing.camera_files import Look, look_at, put
from training.posing.pairs import how_many_pairs
from training.posing.prepare import chosen_looks, file_stems
from training.posing.worker import end_with_stdin
from training.scenes.pictures import small_picture
from training.scenes.sources import Source, find_source

SIDE = 160  # pixels of a small picture's longer side
PROBED = 3  # pictures whose features and matches are timed
GLIMPSES = 24  # of a film
FRAMES = 120  # of a film, at most: as of snerg-make
# Time for adding a picture to the model, over that for its features: 0.2 to 1.3 in docs/results.md ("Poses of bare photographs").
POSES_BY_FEATURES = 0.5


def preview(source: Source, folder: Path) -> None:
    """Tells all of the above. UserError where nothing can be read."""
    _film(source, folder) if source.kind == "film" else _photographs(source, folder)


def _photographs(source: Source, folder: Path) -> None:
    _say(count=len(source.files))
    looks: list[tuple[Path, Look]] = []
    aside: dict[str, str] = {}
    looked = 0.0
    for number, file in enumerate(source.files):
        name, small = source.name_of(file), f"{number:05d}.jpg"
        try:
            started = time.monotonic()
            looks.append((file, look_at(file)))
            looked += time.monotonic() - started
            small_picture(file, SIDE, "RGB").save(folder / small, format="JPEG", quality=85)
            _say(name=name, file=small)
        except UserError as error:
            aside[name] = "; ".join(filter(None, (error.what, error.remedy)))
            _say(name=name, file="")
    chosen = chosen_looks(source, looks, aside)
    _say(aside=aside)
    with tempfile.TemporaryDirectory(prefix="snerg-preview-") as temporary:
        names = []
        started = time.monotonic()
        for i, (file, look) in enumerate(_midst(chosen)):
            names.append(put(file, look, Path(temporary), file_stems([f"{i}.x"])[0]))
        looked += (time.monotonic() - started) / max(len(names), 1) * len(chosen)
        _tell_seconds(Path(temporary), names, len(chosen), looked)


def _film(source: Source, folder: Path) -> None:
    from training.posing.film import glimpse

    film = source.files[0]
    with tempfile.TemporaryDirectory(prefix="snerg-preview-") as temporary:
        names: list[str] = []

        def show(number: int, seconds: float, picture: Image.Image) -> None:
            small = f"{number:05d}.jpg"
            if len(names) < PROBED:
                names.append(small)
                picture.save(Path(temporary) / small, quality=95)
            picture.thumbnail((SIDE, SIDE), Image.Resampling.BOX, reducing_gap=2.0)
            picture.save(folder / small, format="JPEG", quality=85)
            _say(name=f"{source.name_of(film)} at {seconds:.1f} s", file=small)

        count, decoding = glimpse(film, FRAMES, GLIMPSES, lambda frames: _say(count=frames), show)
        _say(aside={})
        _tell_seconds(Path(temporary), names, count, decoding)


def _midst(items: Sequence[tuple[Path, Look]]) -> Sequence[tuple[Path, Look]]:
    """PROBED of them that follow one another."""
    first = max((len(items) - PROBED) // 2, 0)
    return items[first : first + PROBED]


def _tell_seconds(images: Path, names: Sequence[str], count: int, looked: float) -> None:
    """Times features and matches of some pictures, and estimates those of all; says nothing where COLMAP is not installed."""
    try:
        from training.posing.mapping import measured
    except ModuleNotFoundError:
        return
    if len(names) < 2:
        return
    features, matches = measured(images, names)
    each = features / len(names)
    _say(seconds={
        "pictures": looked, "features": each * count,
        "matches": matches / how_many_pairs(len(names)) * how_many_pairs(count), "poses": POSES_BY_FEATURES * each * count,
    })  # fmt: skip


def _say(**facts: object) -> None:
    _answers.write(json.dumps(facts) + "\n")
    _answers.flush()


def main() -> int:
    """Entry point; returns the exit status."""
    threading.Thread(target=end_with_stdin, daemon=True).start()
    try:
        source = find_source(Path(sys.argv[1]))
        if source is not None:
            preview(source, Path(sys.argv[2]))
        return 0
    except Exception as error:
        line = str(error) if isinstance(error, UserError) else refusal(error)
        if line is None:
            raise
        _say(error=line)
        return 2


if __name__ == "__main__":
    _answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # libraries print what they like
    sys.exit(main())
