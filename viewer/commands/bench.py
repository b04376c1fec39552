"""snerg-bench: the paper's measurement of frame times (docs/commands.md; SNeRG paper, appendix B)."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.table import Table

from console import UserError, check_results, run_command, write_json
from console.command_line import parse_size
from console.desktop import tell_if_unseen
from scenepack import Pack, load_pack
from training.scenes import Scene
from viewer.benchmark.frames import Contender, Measurement, measure, photographed_scene
from viewer.benchmark.protocols import flight, protocol_for
from viewer.rendering.gpu_scene import OR_HALF, NoRoomError
from viewer.rendering.settings import MARCHERS, RenderSettings

ORBITS = {"paper": "the paper's", "content": "around the content", "given": "as given"}
HEADINGS = ("", "ms mean ± std", "p50", "p95", "p99", "FPS", "p50 / ours", "GPU MiB")


def figures(measurement: Measurement, scene: Scene | None, split: str, *, systems: bool) -> dict[str, Any]:
    """The measured part of the JSON that docs/commands.md promises. scene, split: photographs that were compared with.

    systems: the contenders are two packs, each with a marcher of its own.
    """
    ours, *others = measurement.contenders
    result: dict[str, Any] = {**ours.statistics(), "watts": measurement.watts}
    result["fps_per_watt"] = result["fps"] / measurement.watts if measurement.watts else None
    if scene is not None:
        views = scene.splits[split]
        result["photographs"] = {
            "scene": str(scene.path),
            "split": split,
            "views": len(views),
            "width": views[0].camera.width,
            "height": views[0].camera.height,
            "psnr": ours.photographs_psnr,
        }
    for other in others:
        statistics = other.statistics()
        if systems:
            compared = {**statistics, **other.ratio_to(ours), "psnr": other.photographs_psnr}
            result["against"] = {"systems": [ours.name, other.name], **compared}
        elif other.name == "paper":
            psnr = other.psnr if isfinite(other.psnr) else None  # JSON knows no infinity
            result["compare"] = {"paper": statistics, **other.ratio_to(ours), "psnr": psnr}
        else:
            result.setdefault("ablations", {})[other.name] = statistics
    return result


def title(result: Mapping[str, Any]) -> str:
    text = f"{result['width']}x{result['height']}, {result['frames']} frames, {result['protocol']}, {result['fov']:g}°"
    distance, named = result["distance"], result["distance_from"]
    return text if distance is None else f"{text}, orbit at {distance:.4g} ({ORBITS[named]})"


def notes(result: Mapping[str, Any], measurement: Measurement) -> list[str]:
    """The lines below the table: device and clock, power, comparison."""
    grid = " x ".join(map(str, measurement.grid_size)) + " voxels"
    halved = ", at reduced resolution" if result["halved"] else ""
    lines = [f"{measurement.renderer}; {measurement.clock}; {grid}{halved}"]
    if measurement.watts is not None:
        lines.append(f"{measurement.watts:.1f} W, {result['fps_per_watt']:.3f} FPS/W")
    if "compare" in result:
        psnr = measurement.contenders[1].psnr
        lines.append(f"exact is {_times(result['compare'])} as fast as paper; PSNR between them {psnr:.1f} dB")
    if "against" in result:
        ours, theirs = result["against"]["systems"]
        lines.append(f"{ours} is {_times(result['against'])} as fast as {theirs}")
    if "photographs" in result:
        about = result["photographs"]
        scores = ", ".join(f"{c.name} {c.photographs_psnr:.2f} dB" for c in measurement.contenders)
        lines.append(f"PSNR against {about['views']} photographs ({about['width']}x{about['height']}): {scores}")
    return lines


def _times(compared: Mapping[str, Any]) -> str:
    """A ratio with its spread over pairs of frames."""
    low, high = compared["ratio_p5"], compared["ratio_p95"]
    return f"{compared['ratio']:.2f} times ({low:.2f} to {high:.2f} frame by frame)"


def print_table(result: Mapping[str, Any], measurement: Measurement) -> None:
    table, base = Table(title=title(result)), measurement.contenders[0].statistics()["ms_p50"]
    for i, heading in enumerate(HEADINGS):
        table.add_column(heading, justify="right" if i else "left")
    for contender in measurement.contenders:
        s = contender.statistics()
        times = f"{s['ms_mean']:.2f} ± {s['ms_std']:.2f}", *(f"{s[f'ms_{key}']:.2f}" for key in ("p50", "p95", "p99"))
        rest = f"{s['fps']:.1f}", f"{s['ms_p50'] / base:.2f}", f"{contender.gpu_bytes / 2**20:.1f}"
        table.add_row(contender.name, *times, *rest)
    console = Console(width=None if sys.stdout.isatty() else 120)
    console.print(table)
    for line in notes(result, measurement):
        console.print(line, highlight=False)


# --- The command ---


def bench(
    pack: Path,
    /,
    protocol: Literal["auto", "synthetic", "forward-facing", "real360"] = "auto",
    distance: str = "auto",
    frames: int = 150,
    size: str | None = None,
    fov: float | None = None,
    compare: Literal["paper"] | None = None,
    against: Path | None = None,
    algorithms: str | None = None,
    scene: Path | None = None,
    split: str = "test",
    downscale: int = 1,
    ablations: bool = False,
    allow_half: bool = False,
    surroundings: bool = True,
    json: Path | None = None,
) -> None:
    """Measures frame times along a camera path, as the paper does. Renders offscreen, without vertical sync.

    Args:
        pack: Folder or .zip of a baked scene.
        protocol: synthetic (39 degrees, 800x800, orbit), forward-facing (53 degrees, 1006x756, in the camera plane), real360
            (53 degrees, 990x773, orbit), or auto (forward-facing for such packs, real360 for spherified and unbounded
            scenes, otherwise synthetic).
        distance: How far the orbit is from the origin of the scene: paper (4.0311 for synthetic, 1 for real360, as its
            photographs), content (around the content, just far enough to show all of it), a number in units of the grid, or auto
            (paper if the content lies within that orbit or the scene is unbounded, otherwise content).
        frames: Number of frames to measure, after a warm-up.
        size: Picture size, WIDTHxHEIGHT in pixels. The default is the protocol's.
        fov: Vertical field of view in degrees. The default is the protocol's.
        compare: Also render each frame with the paper's marcher.
        against: Pack of the same scene to render in turn with this one, each with its own algorithm: two systems are compared.
        algorithms: With --against, the marcher of each pack, for example exact,exact. The default is exact,paper.
        scene: Also measure the PSNR against the photographs of this scene.
        split: Which photographs to use: test, train or val.
        downscale: Divide width and height of the photographs by this whole number.
        ablations: Also measure the rows of the paper's performance table (without view MLP, view MLP at every sample), and
            rendering that takes every sample.
        allow_half: Measure a pack that does not fit on the graphics card at half its resolution. Without this option, such a
            pack is refused.
        surroundings: Whether to show what lies beyond the inner cube of an unbounded scene.
        json: Also write the figures to this file; "-" prints them instead of the table.
    """
    if frames < 1:
        raise UserError("needs at least one frame", where="--frames", found=frames)
    if fov is not None and not 0.1 <= fov < 179:
        raise UserError("is not a field of view", where="--fov", expected="0.1 ... 179 degrees", found=fov)
    pixels = parse_size(size) if size else None
    marchers = _marchers(against, algorithms, compare, ablations)
    check_results(json)
    loaded = load_pack(pack)
    flown = flight(loaded, protocol_for(loaded, protocol), frames, fov=fov, size=pixels, distance=distance)
    photographs = photographed_scene(loaded, scene, split, downscale) if scene is not None else None
    if against is not None:
        contenders = _systems(pack, loaded, against, marchers)
    else:
        contenders = _contenders(loaded, compare is not None, ablations)
    for contender in contenders:
        contender.settings = replace(contender.settings, surroundings=surroundings)
    try:
        measurement = measure(flown.cameras, contenders, scene=photographs, split=split, allow_half=allow_half)
    except NoRoomError as error:
        raise error if allow_half else error.with_remedy(OR_HALF) from error
    result = {
        "renderer": measurement.renderer,
        **flown.facts,
        "frames": frames,
        "grid_size": measurement.grid_size,
        "halved": measurement.grid_size != tuple(loaded.grid_size),
        "clock": measurement.clock,
        **figures(measurement, photographs, split, systems=against is not None),
    }
    if not write_json(json, result):
        print_table(result, measurement)


def _marchers(against: Path | None, algorithms: str | None, compare: str | None, ablations: bool) -> tuple[str, str]:
    """The marchers of the two packs of --against. UserError where the options contradict one another."""
    if against is None:
        if algorithms is not None:
            raise UserError("needs --against", where="--algorithms")
        return "exact", "exact"
    for option, given in (("--compare", compare), ("--ablations", ablations)):
        if given:
            raise UserError("exclude each other", where=f"--against and {option}", remedy="keep one of them")
    names = (algorithms or "exact,paper").split(",")
    if len(names) != 2 or not set(names) <= set(MARCHERS):
        expected = f"two of {', '.join(MARCHERS)}, such as exact,paper"
        raise UserError("are not algorithms of two packs", where="--algorithms", expected=expected, found=algorithms)
    return names[0], names[1]


def _systems(path: Path, pack: Pack, against: Path, marchers: tuple[str, str]) -> list[Contender]:
    """Two packs of one scene, each with a marcher of its own."""
    other = load_pack(against)
    if other.ndc != pack.ndc:
        what = "cannot be seen by the same cameras: one of the packs is forward-facing"
        raise UserError(what, where=f"--against {against}")
    names = [f"{each.resolve().name}, {marcher}" for each, marcher in zip((path, against), marchers, strict=True)]
    if names[0] == names[1]:
        names[1] += ", again"
    first, second = (RenderSettings(marcher=marcher) for marcher in marchers)  # type: ignore[arg-type]
    return [Contender(names[0], first, pack), Contender(names[1], second, other)]


def _contenders(pack: Pack, paper: bool, ablations: bool) -> list[Contender]:
    ways = {"exact": RenderSettings()}
    if paper:
        ways["paper"] = RenderSettings(marcher="paper")
    if ablations and pack.view_mlp is not None:
        ways["exact, no view MLP"] = RenderSettings(mode="diffuse")
        ways["exact, view MLP at every sample"] = RenderSettings(view_mlp_per_sample=True)
    if ablations:
        ways["no skipping: every sample"] = RenderSettings(marcher="brute")
    return [Contender(name, settings, pack) for name, settings in ways.items()]


def main(args: Sequence[str] | None = None) -> int:
    return run_command(bench, prog="snerg-bench", args=args, on_failure=tell_if_unseen)
