"""What photographs are worth before anything is trained: sharpness, overlap, exposure, what moves, which to take again, and the
PSNR to expect.

Nothing is reconstructed: features of small copies are matched, and the pairs that match tell the rest. Notation: N photographs;
x [N] logarithms of exposure, fitted to the brightness ratios of matching features, their median 0.
"""

import base64
import html
import io
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter
from scipy.sparse.csgraph import connected_components

from console import Progress, UserError, progress
from console.atomic import replacing
from console.streams import one_line
from training.posing.child_process import ask
from training.posing.find import require
from training.posing.photograph import sharpness
from training.posing.prepare import IMAGES, LOG, CameraGroup, Prepared, camera_groups, prepare
from training.scenes.files import few, notice
from training.scenes.pictures import preview_of, small_picture
from training.scenes.sources import FEWEST, Source

STAGE = "check"
LONGEST_SIDE, MOST_FEATURES = 640, 600  # of the copies that are matched, to be quick
BRIGHTNESS_SIDE = 200  # pixels in which the brightness around a feature is read
THUMBNAIL = 176  # pixels
DARKEST = 0.04  # darker pixels are not used to compare exposures
PARTNERS = 4  # a photograph overlaps as well as it matches so many others
GOOD_OVERLAP, GOOD_SHARPNESS = 0.25, 0.5  # about those of fern and fox, medians (docs/results.md)
FEW_PARTNERS = 2  # that a photograph matches, at most, which stands apart
EXPOSURE_JUMP = 0.25  # of x: from here on a photograph is said to differ
MUCH_MOVES = 0.45  # of the matches of a pair; mistakes alone make 0.1 to 0.3
AROUND_SHARE = 0.9  # of all pairs: where more match, all photographs show one side
WALK = "walked around or through"
ENDS = 3  # photographs at the beginning and at the end of a walk
TURNED = 0.9  # of the pairs: where more do, the camera turned on the spot
# Expected errors, fitted to 20 versions of five captures that were trained (docs/results.md)
TRAINED_SIDE = 256  # pixels of the photographs, as of the preset quick
ERROR_OF_DETAIL, ERROR_BY_COUNT, ERROR_AROUND, ERROR_OF_BLUR, ERROR_OF_EXPOSURE = 2.6, -0.76, 8.0, 4.0, 0.1
MOST_PSNR = 35.0  # dB; the best of these versions has 32.6


@dataclass(frozen=True)
class Verdict:
    """What was found of N photographs, in their order."""

    figures: dict[str, Any]  # what `snerg-make --check --json` writes (docs/scenes.md)
    matches: np.ndarray  # [N, N]: share of features in common

    @property
    def retake(self) -> dict[str, str]:
        """Why, by the name that the user knows, a photograph that is used should be taken again."""
        return {**self.figures["weakly_connected"], **self.figures["differently_exposed"]}

    def lines(self) -> list[str]:
        """What a user should know, a line each."""
        found, psnr = self.figures, self.figures["expected_psnr"]
        expected = "" if psnr is None else f"; about {psnr:.0f} dB PSNR to be expected from the preset quick"
        lines = [
            f"{len(self.matches)} photographs, {found['kind']}" + expected,
            f"sharpness {found['sharpness']:.0%} and overlap {found['overlap']:.0%} of what is good; "
            f"{found['connected']:.0%} are connected by matches; "
            f"exposures differ by {found['exposure_spread']:.0%}; {found['moving']:.0%} of the matches move",
        ]
        if found["kind"] == WALK:
            closed = (self.matches[:ENDS, -ENDS:] > 0).any()
            ends = "the last match none of the first: the walk is open"
            lines.append("the last match the first: the walk closes" if closed else ends)
        if found["moving"] > MUCH_MOVES:
            lines.append("much moves: leaves, people, reflections; or the photographs are blurred")
        if len(self.matches) < FEWEST:
            lines.append(f"too few to find camera poses: at least {FEWEST} are needed")
        lines += [f"left out {name}: {why}" for name, why in found["set_aside"].items()]
        lines += [f"take again {name}: {why}" for name, why in self.retake.items()]
        return [one_line(line) for line in lines]


def check(source: Source, page: Path, most_frames: int) -> Verdict:
    """Looks at photographs or a film, and writes a page about them. UserError where too few can be read, ModuleNotFoundError
    where a package is missing.
    """
    for note in source.notes:
        notice(source.path, note)
    require(source)
    with tempfile.TemporaryDirectory(prefix="snerg-check-") as folder:
        work = Path(folder)
        with progress("looking at photographs", len(source.files), stage=STAGE) as bar:
            prepared = prepare(source, work, most_frames, bar)
        if len(prepared.pictures) < 2:
            left_out = few([f"{name} ({why})" for name, why in prepared.aside.items()])
            raise UserError("too few photographs that can be used", where=source.path, expected=f"at least {FEWEST}",
                            found=f"{len(prepared.pictures)}{', without ' * bool(left_out)}{left_out}")  # fmt: skip
        files = [work / IMAGES / picture.name for picture in prepared.pictures]
        with progress("matching", 2, stage=STAGE) as bar:
            found = match_small(work, [file.name for file in files], camera_groups(prepared.pictures), bar)
        verdict = judge(prepared, files, found["pairs"], found["is_static"])
        page.parent.mkdir(parents=True, exist_ok=True)
        with replacing(page) as new:
            new.write_text(_page(source, verdict, files), encoding="utf-8")
    return verdict


def match_small(
    work: Path, names: Sequence[str], groups: Sequence[CameraGroup], bar: Progress, begun: float = 0.0
) -> dict[str, Any]:
    """Matches the pictures in `work` / IMAGES at LONGEST_SIDE pixels; returns what mapping.matching_pairs does. The bar advances
    from `begun` to `begun` + 2."""
    request = {
        "images": str(work / IMAGES), "work": str(work), "names": names, "groups": groups,
        "longest_side": LONGEST_SIDE, "most_features": MOST_FEATURES,
    }  # fmt: skip

    def on_progress(title: str, done: float, total: float) -> None:
        bar.update(begun + (title == "matches") + done / total)

    return ask("matching_pairs", request, work / LOG, on_progress)


def judge(prepared: Prepared, files: Sequence[Path], pairs: Sequence[dict[str, Any]], is_static: bool) -> Verdict:
    """The verdict on pictures, by the pairs that match: see mapping.matching_pairs."""
    names = [picture.display_name for picture in prepared.pictures]
    row = {file.name: index for index, file in enumerate(files)}
    previews = [preview_of(file) for file in files]
    matches = np.zeros((len(files),) * 2)
    for pair in pairs:
        i, j = row[pair["first"]], row[pair["second"]]
        matches[i, j] = matches[j, i] = pair["share"]
    partners = (matches > 0).sum(1)
    overlap = np.sort(matches, axis=1)[:, -PARTNERS:].mean(1)
    sharp = [sharpness(preview) for preview in previews]
    exposure = _exposures(previews, pairs, row)
    part = connected_components(matches > 0)[1]
    together = part == np.bincount(part).argmax()
    share = (matches > 0).sum() / max(together.sum() * (together.sum() - 1), 1)  # nearly all matches are among these
    kind = "seen from one side" if share > AROUND_SHARE else WALK
    if pairs and np.mean([pair["turned"] for pair in pairs]) > TURNED:
        kind = "turned on the spot: without moving, nothing tells how far things are"
    if is_static:
        kind = "a turntable before a still background: masks are needed"
    weak, exposed = {}, {}
    for index, name in enumerate(names):
        if not together[index] or not partners[index]:
            weak[name] = "does not overlap with the others"
        elif partners[index] <= FEW_PARTNERS:
            others = "1 other" if partners[index] == 1 else f"{partners[index]} others"
            weak[name] = f"overlaps with {others} only: take one between them"
        elif abs(exposure[index]) > EXPOSURE_JUMP:
            how = "brighter" if exposure[index] > 0 else "darker"
            exposed[name] = f"{abs(np.expm1(exposure[index])):.0%} {how} than the others"
    good_sharpness, good_overlap = min(_median(sharp) / GOOD_SHARPNESS, 1.0), min(_median(overlap) / GOOD_OVERLAP, 1.0)
    spread = float(np.sqrt(np.mean(exposure**2)))
    around = kind == WALK and np.asarray(small_picture(files[0], THUMBNAIL, "RGBA"))[..., 3].min() == 255
    hopeless = is_static or kind.startswith("turned")
    figures = {
        "expected_psnr": None if hopeless else expected_psnr(previews, int(together.sum()), good_sharpness, spread, around),
        "kind": kind, "sharpness": good_sharpness, "overlap": good_overlap,
        "connected": float(together.mean()), "exposure_spread": spread, "moving": _median([pair["moving"] for pair in pairs]),
        "set_aside": dict(prepared.aside), "weakly_connected": weak, "differently_exposed": exposed,
        "photographs": [
            {"name": name, "sharpness": sharp[i], "overlap": float(overlap[i]), "matches": int(partners[i]),
             "exposure": float(exposure[i])}
            for i, name in enumerate(names)
        ],
    }  # fmt: skip
    return Verdict(figures, matches)


def expected_psnr(
    previews: Sequence[np.ndarray], count: int, sharp: float, exposure_spread: float, around: bool
) -> float:
    """PSNR in dB that photographs which are held out will have, as large as the preset quick trains on: by the detail that a
    field of `count` photographs does not learn, by what blur has taken from them, and by exposures. The three errors add up.
    previews: grey [h, w] in [0, 1]. sharp: of what is good, 0 to 1. around: walked around, not cut out by alpha."""
    fine = coarse = bright = 0.0
    for preview in previews:
        picture = Image.fromarray(preview)
        picture.thumbnail((TRAINED_SIDE, TRAINED_SIDE), Image.Resampling.BOX)
        pixels = np.asarray(picture)
        blurred = [gaussian_filter(pixels, sigma) for sigma in (1, 2, 4)]
        fine += np.square(pixels - blurred[0]).mean() / len(previews)
        coarse += np.square(blurred[1] - blurred[2]).mean() / len(previews)
        bright += np.square(pixels).mean() / len(previews)
    error = ERROR_OF_DETAIL * (fine + 2 * coarse) * count**ERROR_BY_COUNT * (ERROR_AROUND if around else 1.0)
    error += ERROR_OF_BLUR * coarse * (1.0 - sharp) + ERROR_OF_EXPOSURE * bright * exposure_spread**2
    return min(-10.0 * float(np.log10(error + 1e-12)), MOST_PSNR)


def _exposures(previews: Sequence[np.ndarray], pairs: Sequence[dict[str, Any]], row: dict[str, int]) -> np.ndarray:
    """x [N], by least squares over the pairs; those that match none stay at 0."""
    steps = [max(max(preview.shape) // BRIGHTNESS_SIDE, 1) for preview in previews]
    small = [np.asarray(Image.fromarray(preview).reduce(step)) for preview, step in zip(previews, steps, strict=True)]
    system, ratios = [], []
    for pair in pairs:
        both = row[pair["first"]], row[pair["second"]]
        at = np.array(pair["places"]).reshape(-1, 2, 2)
        values = []
        for k, index in enumerate(both):
            height, width = small[index].shape
            x, y = (at[:, k] * (width, height)).astype(int).T
            values.append(small[index][np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)])
        seen = np.minimum(*values) > DARKEST
        if seen.any():
            equation = np.zeros(len(previews))
            equation[both[1]], equation[both[0]] = 1.0, -1.0
            system.append(equation)
            ratios.append(np.median(np.log(values[1][seen] / values[0][seen])))
    if not system:
        return np.zeros(len(previews))
    x = np.linalg.lstsq(np.array(system), np.array(ratios), rcond=None)[0]
    return x - np.median(x)


def _median(values: Sequence[float] | np.ndarray) -> float:
    return float(np.median(values)) if len(values) else 0.0


# --- the page ---------------------------------------------------------------------------------------------------------

STYLE = """body{font:15px system-ui;margin:2em auto;padding:0 1em;max-width:72em;background:#16181c;color:#ddd}
figure{display:inline-block;margin:4px;width:184px;vertical-align:top;font-size:12px}
figure img{max-width:176px;border:4px solid #2c3138}figure.again img{border-color:#d9534f}
.map{image-rendering:pixelated;width:24em}"""
MAP = (
    "Which photographs match, row by column in their order: a broad diagonal is good overlap, bright corners close a circle, "
    "gaps are places to take more."
)


def _page(source: Source, verdict: Verdict, files: Sequence[Path]) -> str:
    """One page without any other file: what was found, who matches whom, and all pictures."""
    title = html.escape(source.path.name)
    step = verdict.matches / max(float(verdict.matches.max()), 1e-9)
    shades = np.stack([255 * step, 200 * step**0.5, 60 + 100 * step], -1).astype(np.uint8)
    about = "".join(f"<li>{html.escape(line)}</li>" for line in verdict.lines())
    page = [
        f'<!doctype html><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>',
        f"<h1>{title}</h1><ul>{about}</ul>",
        f'<p><img class="map" src="{_data_uri(Image.fromarray(shades), "PNG")}" alt=""><br>{MAP}</p>',
    ]
    for found, file in zip(verdict.figures["photographs"], files, strict=True):
        name, why = html.escape(found["name"]), html.escape(verdict.retake.get(found["name"], ""))
        text = f"sharpness {min(found['sharpness'] / GOOD_SHARPNESS, 1):.0%}, matches {found['matches']} others"
        picture = f'<img src="{_data_uri(small_picture(file, THUMBNAIL, "RGB"), "JPEG")}" alt="">'
        page.append(f'<figure class="{"again" if why else ""}">{picture}<figcaption>{name}<br>{text}<br>'
                    f"<b>{why}</b></figcaption></figure>")  # fmt: skip
    return "\n".join(page) + "\n"


def _data_uri(picture: Image.Image, form: str) -> str:
    data = io.BytesIO()
    picture.save(data, format=form, quality=80)
    return f"data:image/{form.lower()};base64,{base64.b64encode(data.getvalue()).decode()}"
