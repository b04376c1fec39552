"""`python -m tools.scaling --out FOLDER`: how frame time grows with resolution, picture size and opacity.

The scene is carved from formulas, one macroblock at a time, so that 1000^3 voxels take no more memory than its
occupied macroblocks. exact and paper take turns frame by frame, and so does a reference scene that stays the same, for
machines are not equally busy all the time; the medians are plotted, scaled by the reference's.
Notation: opacity is that of one voxel inside of a surface, which is SHELL voxels thick at every resolution.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from console import UserError, check_results, run_command, write_json
from console.command_line import parse_numbers
from console.plots import Line, Plot, draw_plots, require_plots
from scenepack.blocks import fill_atlas, grid_block_counts, restore_pack_padding
from scenepack.pack import Pack
from tests.scenepack.volumes import pack_of_cube
from tests.viewer.rendering.shapes import BLENDER_FRAME, glossy_mlp
from viewer.benchmark.frames import Contender, measure
from viewer.rendering.camera import orbit_path
from viewer.rendering.settings import RenderSettings

BLOCK_SIZE = 30
SHELL = 3.0  # voxels
FOV = 39.0  # degrees, the synthetic protocol's
OPACITIES = (0.02, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0)
MIDDLE_SIDE = 200  # pixels, where something else varies
VARIED = {"resolution": "voxels", "size": "pixels", "opacity": "opacity"}

Figures = dict[str, list[dict[str, float]]]  # by what varies, a point each


def surface_distance(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Distance, at least, to the nearest surface of the scene in [-1, 1]^3: a ball, a ring, a post and a plate."""
    ball = np.abs(np.sqrt((x - 0.25) ** 2 + y**2 + (z - 0.1) ** 2) - 0.35)
    ring = np.abs(np.hypot(np.hypot(x + 0.4, z + 0.3) - 0.33, y + 0.1) - 0.1)
    post = np.maximum(np.abs(np.hypot(x + 0.4, z - 0.5) - 0.08), np.abs(y) - 0.5)
    plate = np.abs(np.maximum(np.maximum(np.abs(x), np.abs(z)) - 0.8, np.abs(y + 0.6) - 0.04))
    return np.minimum(np.minimum(ball, ring), np.minimum(post, plate))


def carved_pack(side: int, opacity: float = 1.0) -> Pack:
    """The scene as a pack of side^3 voxels with features and a view MLP."""
    voxel = 2.0 / side

    def centres(first: int, last: int) -> np.ndarray:
        return ((np.arange(first, last, dtype=np.float32) + 0.5) * voxel - 1.0).astype(np.float32)

    def content_of(block: tuple[int, ...]) -> tuple[tuple[int, ...], np.ndarray]:
        z, y, x = np.ix_(*(centres(i * BLOCK_SIZE, (i + 1) * BLOCK_SIZE) for i in block))
        depth = 0.5 * SHELL + 0.5 - surface_distance(x, y, z) / voxel
        alpha = np.rint(255.0 * opacity * np.clip(depth, 0.0, 1.0))[..., None]
        waves = np.stack(np.broadcast_arrays(np.sin(9 * x), np.sin(7 * y + 1), np.cos(8 * z), alpha[..., 0]), axis=-1)
        content = np.rint((0.45 + 0.3 * waves[..., :3]) * alpha).astype(np.uint8)
        alpha = alpha.astype(np.uint8)
        return block, np.concatenate([content, alpha, content[..., ::-1], alpha // 2], axis=-1)

    counts = grid_block_counts((side, side, side), BLOCK_SIZE)
    middles = ((np.arange(counts[0]) + 0.5) * BLOCK_SIZE * voxel - 1.0).astype(np.float32)
    reach = (np.sqrt(3.0) * (0.5 * BLOCK_SIZE + 1.0) + SHELL) * voxel
    occupied = surface_distance(*reversed(np.ix_(middles, middles, middles))) < reach
    atlas = fill_atlas(map(content_of, map(tuple, np.argwhere(occupied).tolist())), occupied, BLOCK_SIZE)
    pack = pack_of_cube(side, BLOCK_SIZE, atlas, glossy_mlp(), BLENDER_FRAME)
    restore_pack_padding(pack)
    return pack


def times(pack: Pack, side: int, frames: int, reference: Pack) -> dict[str, float]:
    """Median milliseconds of each marcher at side × side pixels, of `reference`, and MiB of textures for `exact`."""
    cameras = orbit_path(pack, frames, FOV, (side, side))
    paper = RenderSettings(marcher="paper")
    contenders = [Contender("paper", paper, pack), Contender("exact", RenderSettings(), pack)]
    measured = measure(cameras, [*contenders, Contender("reference", paper, reference)])
    medians = {contender.name: contender.statistics()["ms_p50"] for contender in measured.contenders}
    return {**medians, "gpu_mib": contenders[1].gpu_bytes / 2**20}


def remove_drift(points: list[dict[str, float]]) -> None:
    """Makes the points as if the machine had been equally busy at each: scaled by how long the reference scene took then."""
    usual = float(np.median([point["reference"] for point in points]))
    for point in points:
        slower = point["reference"] / usual
        point["exact"], point["paper"] = point["exact"] / slower, point["paper"] / slower


def measured(sides: Sequence[int], pixels: Sequence[int], frames: int) -> Figures:
    """What plots_of draws: grids of `sides` voxels a side, pictures of `pixels` a side, `frames` of one orbit a point."""
    result: Figures = {"resolution": [], "size": [], "opacity": []}
    reference = carved_pack(sides[0])
    for side in sides:
        point = times(carved_pack(side), MIDDLE_SIDE, frames, reference)
        result["resolution"].append({"voxels": side, **point})
    for opacity in OPACITIES:
        point = times(carved_pack(sides[0], opacity), MIDDLE_SIDE, frames, reference)
        result["opacity"].append({"opacity": opacity, **point})
    for what in ("resolution", "opacity"):
        remove_drift(result[what])
    for side in pixels:  # no reference: it would be drawn at the same size
        result["size"].append({"pixels": side, **times(reference, side, frames, reference)})
    return result


def plots_of(result: Figures) -> dict[str, Plot]:
    """A plot for each thing that varies, by its name."""
    area, first = f"{MIDDLE_SIDE} × {MIDDLE_SIDE} pixels", f"{result['resolution'][0]['voxels']:g}³ voxels"
    titles = {
        "resolution": (f"Frame time and grid resolution, {area}", "voxels a side"),
        "size": (f"Frame time and picture size, {first}", "pixels a side"),
        "opacity": (f"Frame time and opacity, {first}, {area}", "opacity of one voxel"),
    }
    plots = {}
    for what, (title, x_label) in titles.items():
        points, key = result[what], VARIED[what]
        lines = [
            Line(name, [p[key] for p in points], [p[name] for p in points], marked=True) for name in ("exact", "paper")
        ]
        plots[what] = Plot(lines, title, x_label, "milliseconds, median")
    return plots


def in_words(result: Figures) -> Iterator[str]:
    """A line for each point."""
    for what, points in result.items():
        for p in points:
            yield (
                f"{what} {p[VARIED[what]]:g}: exact {p['exact']:.1f} ms, paper {p['paper']:.1f} ms, "
                f"{p['paper'] / p['exact']:.2f}, {p['gpu_mib']:.0f} MiB"
            )


DESCRIPTION = "Plots frame time against grid resolution, picture size and opacity, on carved scenes."


def scaling(
    out: Path,
    frames: int = 12,
    resolutions: str = "256,512,750,1000",
    sizes: str = "100,200,400,800",
) -> None:
    """Plots frame time against grid resolution, picture size and opacity, on carved scenes.

    Args:
        out: Folder for scaling-resolution.png, scaling-size.png, scaling-opacity.png and scaling.json.
        frames: Number of frames of the orbit that measures each point.
        resolutions: Voxels per side, separated by commas. 1000 takes about 4 GB of memory.
        sizes: Width and height of the pictures in pixels, separated by commas.
    """
    require_plots()
    check_results(folder=out)
    if frames < 1:
        raise UserError("needs at least one frame", where="--frames", found=frames)
    sides = [int(n) for n in parse_numbers(resolutions, resolutions.count(",") + 1, "--resolutions")]
    pixels = [int(n) for n in parse_numbers(sizes, sizes.count(",") + 1, "--sizes")]
    if min(sides) < BLOCK_SIZE or min(pixels) < 1:
        raise UserError("is too small", where="--resolutions" if min(sides) < BLOCK_SIZE else "--sizes")
    result = measured(sides, pixels, frames)
    write_json(out / "scaling.json", result)
    for what, plot in plots_of(result).items():
        draw_plots(out / f"scaling-{what}.png", [plot], (600, 340))
    for line in in_words(result):
        print(line)


if __name__ == "__main__":
    sys.exit(run_command(scaling, prog="python -m tools.scaling", description=DESCRIPTION))
