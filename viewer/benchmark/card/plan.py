"""Which parts a report has, and the packs and the scene that are at hand for it."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from viewer.benchmark.card.children import Training, golden
from viewer.benchmark.card.drawing import Look, device, pack_figures
from viewer.benchmark.card.parts import Part

DEMO = Path(__file__).resolve().parents[2] / "demo" / "demo.zip"
DATA = "SNERG_DATA"
PARAMS = "scene_params.json"
LEGO = Path("nerf_synthetic") / "lego"
LEAST_PACK_S, LEAST_TRAINING_S = 30.0, 60.0


@dataclass(frozen=True)
class Wanted:
    """packs: besides those that are found. only: leave those out. scene: to train on; None takes lego, or renders one.

    train_minutes: of the preset `curve`; 0 trains nothing. step: preset whose step is timed. curve_options, step_options:
    further options of snerg-train.
    """

    packs: Sequence[Path] = ()
    only: bool = False
    look: Look = field(default_factory=Look)
    scene: Path | None = None
    downscale: int = 1
    train_minutes: float = 6.0
    curve: str = "full"
    step: str = "paper"
    curve_options: str = ""
    step_options: str = ""
    processor_too: bool = False


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


def parts_of(wanted: Wanted, out: Path) -> list[Part]:
    """What matters most comes first, for time may end."""
    parts = [Part("device", lambda _: device()), Part("golden pictures", partial(golden, out))]
    for name, path in packs_at_hand(wanted.packs, only=wanted.only).items():

        def figures(_: object, path: Path = path, name: str = name) -> dict:
            return pack_figures(path, name, out, wanted.look)

        parts.append(Part(f"pack {name}", figures, LEAST_PACK_S))
    if wanted.train_minutes > 0:
        options = {
            wanted.curve: shlex.split(wanted.curve_options),
            wanted.step: shlex.split(wanted.step_options),
        }
        scene = scene_at_hand(wanted.scene)
        scene = scene.resolve() if scene is not None else None
        training = Training(out.resolve(), scene, wanted.downscale, wanted.processor_too, options)
        parts += [
            Part("jax", training.devices),
            Part(f"curve of {wanted.curve}", partial(training.curve_of, wanted.curve, wanted.train_minutes)),
            Part(f"step of {wanted.step}", partial(training.step_of, wanted.step), LEAST_TRAINING_S),
            Part(f"step of {wanted.curve}, in parts", partial(training.parts_of_step, wanted.curve), LEAST_TRAINING_S),
        ]
    return parts
