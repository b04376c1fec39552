"""`python -m tools.card --out DIR`: measures all figures of a graphics card, and writes a report (docs/card.md)."""

import os
import shutil
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from console import UserError, check_results, run_command, write_result
from console.command_line import parse_size
from tools.card.opengl import Sizes, device, pack_figures
from tools.card.page import page
from tools.card.parts import Part, run_parts
from tools.card.subprocesses import ROOT, Training, golden

PROG = "python -m tools.card"
DESCRIPTION = "Measures everything that this repository wants to know of a graphics card, and writes a report."
DEMO = ROOT / "viewer" / "demo" / "demo.zip"
DATA = "SNERG_DATA"
PARAMS = "scene_params.json"
LEGO = Path("nerf_synthetic") / "lego"
LEAST_PACK_S, LEAST_TRAINING_S = 30.0, 60.0


def packs_at_hand(given: Sequence[Path], *, only: bool = False) -> dict[str, Path]:
    """Packs by a name of their own: those given, the bundled demo, and those in packs/ and out/ here and below SNERG_DATA."""
    found = list(given)
    if not only:
        found.append(DEMO)
        data = os.environ.get(DATA)
        folders = [Path("packs"), Path("out"), *([Path(data) / "packs"] if data else [])]
        for folder in folders:
            for depth in ("*", "*/*"):
                found += sorted(params.parent for params in folder.glob(f"{depth}/{PARAMS}"))
    named: dict[str, Path] = {}
    for path in found:
        if path.resolve() in [other.resolve() for other in named.values()]:
            continue
        name = path.resolve().stem if path.suffix == ".zip" else path.resolve().name
        name = f"{path.resolve().parent.name}-{name}" if name == "pack" or name in named else name
        while name in named:
            name += "-again"
        named[name] = path
    return named


def scene_at_hand(given: Path | None) -> Path | None:
    """The scene to train on; None where one must be rendered."""
    data = os.environ.get(DATA)
    if given is None and data and (Path(data) / LEGO).is_dir():
        return Path(data) / LEGO
    return given


def card_report(
    out: Path,
    pack: tuple[Path, ...] = (),
    only: bool = False,
    size: str = "800x800",
    frames: int = 150,
    views: int = 8,
    power_seconds: float = 4.0,
    scene: Path | None = None,
    downscale: int = 1,
    train_minutes: float = 6.0,
    curve_preset: str = "full",
    step_preset: str = "paper",
    processor_too: bool = False,
    minutes: float = 20.0,
) -> None:
    """Measures everything that this repository wants to know of a graphics card, and writes a report.

    Args:
        out: Folder for report.md, report.json, pictures and logs.
        pack: Packs to measure besides those that are found.
        only: Measure only the packs given with --pack, and not the demo and those found in out/, packs/ and $SNERG_DATA/packs.
        size: Picture size, WIDTHxHEIGHT in pixels.
        frames: Number of frames of the camera path, for frame times.
        views: Number of views in which exactness is checked.
        power_seconds: How long each marcher draws without a pause, to measure its power.
        scene: Scene to train on. The default is lego from $SNERG_DATA, or a scene that is rendered first.
        downscale: Divide width and height of the photographs by this whole number.
        train_minutes: Minutes of training for the curve. 0 leaves all training out.
        curve_preset: Preset whose PSNR over time is measured.
        step_preset: Preset whose step is timed.
        processor_too: Train even if JAX sees no graphics card.
        minutes: Begin nothing after this many minutes.
    """
    for option, value in (("--frames", frames), ("--views", views), ("--downscale", downscale)):
        if value < 1:
            raise UserError("is too small", where=option, expected="at least 1", found=value)
    if minutes <= 0 or not 0 <= train_minutes <= minutes:
        raise UserError(
            "do not fit together", where="--minutes and --train-minutes", expected="0 <= --train-minutes <= --minutes"
        )
    sizes = Sizes(parse_size(size), frames, views, power_seconds)
    check_results(folder=out)
    for path in (*pack, *([scene] if scene is not None else [])):
        if not path.exists():
            raise UserError("there is no such file or folder", where=path)
    out = out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    runs = out / "work"
    shutil.rmtree(runs, ignore_errors=True)  # of a report that was interrupted
    parts = [Part("device", lambda _: device()), Part("golden pictures", partial(golden, out))]
    for name, path in packs_at_hand(pack, only=only).items():
        parts.append(Part(f"pack {name}", partial(pack_figures, path, name, out, sizes), LEAST_PACK_S))
    if train_minutes > 0:
        found = scene_at_hand(scene)
        training = Training(out, found and found.resolve(), downscale, processor_too)
        parts += [
            Part("jax", training.devices),
            Part(f"curve of {curve_preset}", partial(training.curve_of, curve_preset, train_minutes)),
            Part(f"step of {step_preset}", partial(training.step_of, step_preset), LEAST_TRAINING_S),
            Part(f"step of {curve_preset}, in parts", partial(training.parts_of_step, curve_preset), LEAST_TRAINING_S),
        ]
    try:
        report = run_parts(parts, out, minutes)
    finally:
        shutil.rmtree(runs, ignore_errors=True)
    write_result(out / "report.md", page(report))
    print(out / "report.md")
    failed = [name for name, facts in report["parts"].items() if facts["status"] == "failed"]
    if failed:
        raise UserError(
            f"{len(failed)} of {len(report['parts'])} parts failed",
            where=", ".join(failed),
            remedy=f"see {out / 'report.md'}",
        )


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    return run_command(card_report, prog=PROG, description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
