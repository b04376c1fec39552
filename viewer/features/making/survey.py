"""Survey of photographs before a scene is made of them: what is there, small pictures, and the time, memory and disk it takes.

A child process reads bare photographs and films (training.posing.preview), because a decoder may crash and COLMAP cannot be
interrupted. Another (training.speed) tells how many samples a run takes, and times a few on this machine. A third checks the
photographs themselves.
"""

import importlib.util
import math
import shutil
import webbrowser
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from PIL import Image

from console import UserError, collect_notices
from console.json_text import read_json_file
from training.scenes import Scene, load_scene
from training.scenes.picture_headers import UNREADABLE, read_header
from training.scenes.pictures import is_panorama, preview_of
from training.scenes.presets import PRESETS, bounded_side, voxels_for
from training.scenes.read import has_poses, suggested_downscale
from training.scenes.scene import Kind
from training.scenes.sources import FEWEST, Source, find_source, require_source
from viewer.core.language import translated
from viewer.core.tasks import FolderProcess, JsonTask, Task, temporary_folder
from viewer.rendering.targets import Sheet

OFFERED = {name: preset for name, preset in PRESETS.items() if preset.title}
LONGEST_SIDES = {name: preset.longest_side for name, preset in OFFERED.items() if preset.longest_side is not None}
DOWNSCALES = (1, 2, 4, 8)
KINDS = {"blender": "Blender", "llff": "LLFF", "transforms": "transforms.json", "colmap": "COLMAP"}
MASKED_KINDS = ("llff", "transforms", "colmap")  # layouts whose pictures may have masks beside them
PARTS = ("jax", "matplotlib", "numba", "optax", "safetensors", "scipy")  # the extra `train`
MEASURES = True  # the time that a run takes here
POSES_FIRST = "Nothing says where the camera stood: that is found first."
CELL = 160  # pixels a side: no small picture is larger
COLUMNS, ROWS = 16, 16  # of the sheet; later pictures are counted, and not shown


class BarePreview(JsonTask, Sheet):
    """Starts to read `source` at once. Poll `news` from the main thread; close it in the end. None: not known yet."""

    def __init__(self, source: Source) -> None:
        self.of_film = source.kind == "film"
        self.count: int | None = None  # photographs, or frames that would be used
        self.names: list[str] = []  # of the pictures read so far, in order
        self.aside: Mapping[str, str] | None = None  # reasons for rejected pictures, by name
        self.seconds: Mapping[str, float] | None = None  # estimated, for finding the poses, by stage
        self.error = ""  # why reading stopped early
        self._folder = temporary_folder("snerg-preview-")
        Sheet.__init__(self, CELL, COLUMNS, ROWS)
        super().__init__("training.posing.preview", [str(source.path.resolve()), str(self._folder)], self._take)

    def _listen(self) -> None:
        try:
            super()._listen()
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _take(self, message: Mapping[str, Any]) -> None:
        if "name" in message:
            if message["file"] and len(self.names) < ROWS * COLUMNS:
                with suppress(*UNREADABLE), Image.open(self._folder / message["file"], formats=["JPEG"]) as opened:
                    self.put(len(self.names), np.asarray(opened.convert("RGB")))
            self.names.append(message["name"])
        for fact in ("count", "aside", "seconds", "error"):
            if fact in message:
                setattr(self, fact, message[fact])

    @property
    def used(self) -> int | None:
        """How many pictures would be used; None before it is known."""
        return None if self.count is None or self.aside is None else self.count - len(self.aside)


# --- Time, memory and disk ---

# A bake at 1000 voxels takes as long as training on so many samples: 600 to 1,400 CPU seconds in docs/results.md, where a
# million samples of lego take 1.1.
SAMPLES_OF_1000 = 7e8
# Peaks of snerg-make on lego at 800 x 800: 2.8, 3.5 and 4.8 GB at 512, 750 and 1000 voxels.
MEMORY, MEMORY_OF_1000 = 2.2e9, 2.6e9
# Bytes of a bake's pieces, and its pack: lego took half of that, rooms take up to twice as many blocks.
DISK_OF_1000 = 1.1e9


class TimeNeeded(JsonTask):
    """An estimate for photographs of these longer sides (pixels), from the moment this is made. Poll `news`, and close it.

    after: what else is being measured, which ends first.
    """

    def __init__(self, sides: Sequence[int], kind: Kind, after: Task[None] | None) -> None:
        self._runs: Mapping[str, Any] = {}
        self._per_sample: float | None = None
        self._after, self._kind = after, kind
        super().__init__("training.speed", [kind, *(str(side) for side in sorted(set(sides)))], self._take)

    def _listen(self) -> None:
        if self._after is not None:
            with suppress(Exception):  # it reports what went wrong itself
                self._after.result()
        super()._listen()

    def seconds(self, preset: str, side: int) -> float | None:
        """For training and baking, without finding poses; None where it is not known, as for presets with the paper's MLP."""
        run = self._runs.get(preset, {}).get(str(side))
        if run is None or self._per_sample is None:
            return None
        return self._per_sample * (run["samples"] + SAMPLES_OF_1000 * self._share(preset, side))

    def disk(self, preset: str, side: int) -> float | None:
        """Bytes for the run, the bake's pieces and the pack; None where it is not known."""
        run = self._runs.get(preset, {}).get(str(side))
        return None if run is None else run["disk"] + DISK_OF_1000 * self._share(preset, side)

    def memory(self, preset: str, side: int) -> float:
        """Bytes that making a scene holds at most, about."""
        return MEMORY + MEMORY_OF_1000 * self._share(preset, side)

    def _share(self, preset: str, side: int) -> float:
        """Of what a bake at 1000 voxels takes: it grows with surfaces."""
        resolution = PRESETS[preset].resolution or voxels_for(side, self._kind)  # type: ignore[index]
        return (resolution / 1000) ** 2

    def _take(self, message: Mapping[str, Any]) -> None:
        self._runs = message.get("runs", self._runs)
        self._per_sample = message.get("seconds_per_sample", self._per_sample)


# --- Survey ---


def trainer_missing() -> bool:
    """Whether this installation is the viewer alone."""
    return any(importlib.util.find_spec(name) is None for name in PARTS)


def poser_missing(source: Source) -> str | None:
    """The extras that this installation lacks to find poses of photographs or of a film; None where it can."""
    needed = {"pycolmap": "poses", **({"av": "video"} if source.kind == "film" else {})}
    missing = [extra for name, extra in needed.items() if importlib.util.find_spec(name) is None]
    return ",".join(missing) or None


class Survey(Task[None]):
    """Reads a scene's description and its pictures' headers in a thread. Poll `finished`, then take the rest.

    anew: poses are found even if there are some.
    """

    def __init__(self, path: Path, anew: bool = False) -> None:
        self.path, self.anew = path, anew
        self.posed = False  # whether there are poses
        self.time: TimeNeeded | None = None  # that a run takes here, where this installation trains
        self.bare: Source | None = None  # photographs or a film whose poses must be found before training
        self.preview: BarePreview | None = None  # of these, where this installation finds poses
        self.error: Exception | None = None  # why it is no scene that can be read
        self.text = ""  # one line about it
        self.kind = ""  # its layout; "" where it has no poses
        self.sizes: dict[int, tuple[int, int]] = {}  # width, height in pixels by downscale
        self.automatic: dict[str, int] = {}  # the downscale of a preset that shrinks
        self.forward = False  # cameras (LLFF, COLMAP) that may be read as looking all around
        self.panoramas = False  # whether the photographs show all around
        self.masks = False  # whether there are any
        self.masked: set[int] = set()  # downscales at which there is one for each photograph
        super().__init__(self._read)

    @property
    def busy(self) -> bool:
        """Whether there will be more to see, or is since news() was asked last."""
        coming = any(each is not None and not each.finished for each in (self, self.preview, self.time))
        return coming or self._seen != (self.state(), self.finished)

    def state(self) -> object:
        return [(each.state(), each.finished) for each in (self.preview, self.time) if each is not None]

    def cancel(self) -> None:
        super().cancel()
        for each in (self.preview, self.time):
            if each is not None:
                each.cancel()

    @property
    def choices(self) -> list[int]:
        """Downscales that differ in what they give, from the largest pictures to the smallest."""
        by_width = dict(sorted((width, downscale) for downscale, (width, _) in self.sizes.items()))
        return [downscale for downscale in reversed(by_width.values()) if downscale in DOWNSCALES]

    def size(self, preset: str, downscale: int | None) -> tuple[int, int] | None:
        """Pixels of the photographs that a run with these options trains on; None where it is not known."""
        return self.sizes.get(downscale or self.automatic.get(preset, 1))

    def _read(self) -> None:
        try:
            self.posed = has_poses(self.path)
            if self.anew or not self.posed:
                self.bare = require_source(self.path) if self.anew else find_source(self.path)
            if self.bare is not None:
                found = self._look_at_bare(self.bare)
                notes = [f"{note}." for note in self.bare.notes]
                self.text = " ".join([f"{found}.", *[POSES_FIRST] * (not self.posed), *notes])
                return
            with collect_notices():
                scene = load_scene(self.path)
                self.automatic = {name: suggested_downscale(self.path, side) for name, side in LONGEST_SIDES.items()}
                for downscale in {*DOWNSCALES, *self.automatic.values()}:
                    with suppress(UserError):
                        self.sizes[downscale] = _size(load_scene(self.path, downscale=downscale))
                        if scene.kind in MASKED_KINDS:
                            load_scene(self.path, downscale=downscale, masks=True)
                            self.masked.add(downscale)
            self.masks = bool(self.masked) or any(self.path.glob("masks*"))
            self.forward, self.kind = scene.ndc, scene.kind
            self.panoramas = next(iter(scene.splits.values()))[0].camera.is_panorama
            width, height = _size(scene)
            count = sum(len(photographs) for photographs in scene.splits.values())
            seen = "forward-facing" if scene.ndc else "360°"
            kind = KINDS.get(scene.kind, scene.kind)
            self.text = f"{count} photographs of {width} × {height}, {seen}  ({kind})"
            self._begin_time()
        except Exception as error:  # shown in the dialog
            self.error = error

    def _look_at_bare(self, source: Source) -> str:
        """What there is, in words; takes from the first photograph what it tells of all. UserError where there are too few."""
        count, is_film = len(source.files), source.kind == "film"
        if not is_film and count < FEWEST:
            raise UserError("too few photographs to find camera poses", where=self.path, expected=f"at least {FEWEST}",
                            found=count)  # fmt: skip
        if poser_missing(source) is None and not self.cancelled:
            with suppress(UserError):  # no temporary folder: there is no preview then
                self.preview = BarePreview(source)
            if self.cancelled and self.preview is not None:  # in the meantime
                self.preview.cancel()
        if is_film:
            return f"A film of {source.files[0].stat().st_size / 1e6:,.0f} MB"
        try:
            size, panorama = read_header(source.files[0]).size, is_panorama(preview_of(source.files[0]))
        except UserError:  # HEIC, say: what cannot be read is reported when poses are found
            return f"{count} photographs"
        self.panoramas = panorama
        bounded = bounded_side(*size, is_panorama=panorama)
        self.automatic = {name: max(math.ceil(bounded / side), 1) for name, side in LONGEST_SIDES.items()}
        possible = [downscale for downscale in {*DOWNSCALES, *self.automatic.values()} if downscale <= min(size)]
        self.sizes = {downscale: (size[0] // downscale, size[1] // downscale) for downscale in possible}
        self.masks = source.masks is not None
        if self.masks and all(source.mask_of(file) is not None for file in source.files):
            self.masked = set(self.sizes)
        self._begin_time()
        return f"{count} {'panoramas' if panorama else 'photographs'} of {size[0]} × {size[1]}"

    def _begin_time(self) -> None:
        if MEASURES and not self.cancelled and not trainer_missing():
            cut_out = self.kind == "blender" or self.masked
            kind: Kind = "forward" if self.forward else "object" if cut_out else "unbounded"
            self.time = TimeNeeded([max(size) for size in self.sizes.values()], kind, self.preview)


def _size(scene: Scene) -> tuple[int, int]:
    camera = next(iter(scene.splits.values()))[0].camera
    return camera.width, camera.height


# --- Check of the photographs: `snerg-make --check` as a child process, and what it found ---

NAMED = 3  # photographs of a kind, by name
RESULT = "check.json"  # in the process's folder
GROUPS = ("set_aside", "weakly_connected", "differently_exposed")  # of photographs to look at


@dataclass
class PhotographCheck(FolderProcess):
    """Checks photographs. Call `poll` now and then; close it in the end."""

    page: Path  # what the process writes
    running: bool = True  # whether there will be a result or an error
    result: Mapping[str, Any] | None = None  # what it found, as `--json` has it
    error: str = ""  # why there is no result
    no_browser: bool = False  # whether none could be started for the page, until that was said

    @classmethod
    def begin(cls, source: Path, out: Path) -> Self:
        """source, out: of the plan. UserError where the process cannot be started."""
        words = [str(source), "--out", str(out), "--check", "--json"]
        return cls.start("make", lambda folder: [*words, str(folder / RESULT)], page=out / "check.html")

    def poll(self) -> bool:
        """Whether there is something new to show."""
        if not self.running:
            return False
        before, status = self.child.report, self.child.poll()
        if status is None:
            return self.child.report != before
        if status == 0:
            try:
                self.result = read_json_file(self.folder / RESULT)
            except (OSError, ValueError) as error:
                self.error = f"what was found cannot be read: {error}"
        else:
            self.error = self.child.error_line()
        self.close()
        return True

    def close(self) -> None:
        """Ends the process, if it runs, without waiting for it; the program's end does."""
        if self.running:
            self.running = False
            Task(self.end, kept=True)

    def open_page(self) -> None:
        Task(lambda: setattr(self, "no_browser", not webbrowser.open(self.page.resolve().as_uri())))


def result_lines(result: Mapping[str, Any]) -> list[tuple[str, bool]]:
    """What was found, a line each, and whether it is a warning."""
    count, aside = len(result["photographs"]), len(result["set_aside"])
    used = f"{count} of {count + aside} photographs are used" if aside else f"{count} photographs"
    good = f"Sharpness {100 * result['sharpness']:.0f} % and overlap {100 * result['overlap']:.0f} % of what is good"
    exposures = f"exposures differ by {100 * result['exposure_spread']:.0f} %"
    lines = [(f"{used}, {result['kind']}.", False), (f"{good}; {exposures}.", False)]
    for group in GROUPS:
        if named := result[group]:
            lines.append((f"{len(named)} {group.replace('_', ' ')}: {few_with_reasons(named)}.", True))
    return lines if len(lines) > 2 else [*lines, ("None needs to be taken again.", False)]


def few_with_reasons(reasons: Mapping[str, str]) -> str:
    """Names with their reasons, the first few of them: "a.jpg (blurred), b.jpg (blurred) and 4 more"."""
    named = ", ".join(f"{name} ({translated(why)})" for name, why in list(reasons.items())[:NAMED])
    return translated(f"{named} and {len(reasons) - NAMED} more") if len(reasons) > NAMED else named
