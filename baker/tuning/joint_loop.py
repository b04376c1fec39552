"""The loop around baker.tuning.tuner.Tuner: which rays, how many at once, for how long.

All photographs are tuned on. Some held back would not tell whether tuning helps: the field knows them by heart, and tuning on the
others makes the pack forget them, while it shows views that nobody trained on better.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import OnShare, PackMarcher
from baker.tuning.shading import Accumulated, ErrorTerms, ShadingInputs, psnr_of, squared_error, to_params
from baker.tuning.tuner import Tuner
from scenepack.codecs.quantisation import EXACT, Steps
from scenepack.pack import Pack
from training.dataset import RayDataset

SCORED_RAYS = 65_536
TILE, PROBED = 4, 16_384  # pixels a side; tiles that are looked at together
# Small cells are sharper where enough rays meet each; cells of one voxel learn the training views by heart.
RAYS_PER_CELL, NARROWEST, WIDEST = 6, 2, 4
MOST_CELLS = 1 << 27  # of a grid, empty ones included: a table of all of them is kept
LEAST_STEPS, FEWEST_SAMPLES = 200, 32_768
CHOOSING = 0.05  # of the time: which tiles meet content
FINAL_RATE = 0.05  # the rates fall log-linearly to this share


@dataclass(frozen=True)
class JointConfig:
    passes: float = 1.3  # over the training rays that meet content
    most_steps: int = 1100  # fewer passes where they would take more: every ray of an indoor scene meets content
    samples: int = 393_216  # marched a step; rays are as many as fill them
    rate: float = 1.0  # Adam's learning rate of straight colours and features at the start, in units of 1/255
    density_rate: float = 0.03  # of a cell's log density
    head_rate: float = 1e-3  # of the view MLP
    steps: Steps = EXACT  # what is stored in multiples of
    seed: int = 0


def joint_tune(
    pack: Pack, dataset: RayDataset, config: JointConfig, on_share: Callable[[float, str], None] = lambda share, text: None,
    by_opacity: bool = False,
) -> tuple[Pack, dict[str, Any]]:  # fmt: skip
    """The pack with voxels and view MLP refined; figures, of training rays before and after. The arrays of `pack` are changed.

    by_opacity: see baker.tuning.shading.ErrorTerms. If no training ray meets the pack, it is returned unchanged, without figures.
    """
    marcher, tiles = PackMarcher(pack, dataset), Tiles(dataset, np.random.default_rng(config.seed))
    probed = tiles.rays(0, PROBED)
    probed = probed[probed >= 0]
    probe = probed[marcher.meets(probed)]
    if not len(probe):
        return pack, {}
    meet = round(len(tiles.numbers) * TILE**2 * len(probe) / len(probed))  # about so many rays meet content
    tuner = Tuner(pack, dataset, cell_for(pack, meet), by_opacity=by_opacity)
    tuner.fill(probe, config.samples, config.seed)
    steps = config.passes * meet / tuner.rays
    if steps < LEAST_STEPS:  # of few rays there are more steps, each with fewer
        tuner.fill(probe, max(int(config.samples * steps / LEAST_STEPS), FEWEST_SAMPLES), config.seed)
        steps = config.passes * meet / tuner.rays
    steps = min(max(int(steps), 1), config.most_steps)
    trained_on = meeting(marcher, tiles, steps * tuner.rays, lambda share: on_share(CHOOSING * share, "choosing rays"))
    on_share(CHOOSING, "compiling")
    before = tuner.score(trained_on[:SCORED_RAYS])
    if config.steps != EXACT:
        tuner.round_to(config.steps)
    colour = config.rate / 255
    rates = np.array([*[colour] * 3, config.density_rate, *[colour] * 4, config.head_rate], np.float32)
    for step in range(steps):
        decay = FINAL_RATE ** (step / steps)
        ids = trained_on.take(np.arange(step * tuner.rays, (step + 1) * tuner.rays), mode="wrap")
        tuner.update(ids, rates * np.float32(decay), step)
        on_share(CHOOSING + (1 - CHOOSING) * (step + 1) / steps, f"step {step + 1} of {steps}")
    after = tuner.score(trained_on[:SCORED_RAYS])
    return tuner.tuned(), {
        "passes": round(steps * tuner.rays / meet, 2),
        "train_psnr_before": round(before[0], 3), "train_psnr_after": round(after[0], 3),
        "samples_a_ray_before": round(before[1], 2), "samples_a_ray_after": round(after[1], 2),
    }  # fmt: skip


def shown_psnr(pack: Pack, dataset: RayDataset, seed: int, *, by_opacity: bool = False) -> float:
    """PSNR (dB) of what the viewer shows of the pack, over a random SCORED_RAYS of the training rays."""
    ids = np.sort(np.random.default_rng(seed).permutation(dataset.count)[:SCORED_RAYS]).astype(np.int32)
    marched = PackMarcher(pack, dataset).accumulate(ids)
    head, rays = pack.view_mlp and to_params(pack.view_mlp), jnp.asarray(ids)
    inputs = ShadingInputs(
        Accumulated(*(jnp.asarray(part) for part in marched)), head, dataset.geometry_at(rays).viewdirs, dataset.colours_at(rays),
        jnp.ones(len(ids), bool), dataset.background,
    )  # fmt: skip
    error, weight = squared_error(inputs, ErrorTerms(pack.ndc, by_opacity), clamped=True)
    return psnr_of(float(error), float(weight))


def cell_for(pack: Pack, rays: int) -> int:
    """Voxels a side of the cells that suit a pack which so many training rays meet: surfaces have a cell for cell² voxels."""
    voxels = int(np.count_nonzero(pack.atlas_rgba[..., 3]))
    cell = min(round(float(np.sqrt(RAYS_PER_CELL * voxels / max(rays, 1)))), WIDEST)
    return max(cell, NARROWEST, int(np.ceil((np.prod(pack.grid_size, dtype=float) / MOST_CELLS) ** (1 / 3))))


class Tiles:
    """Tiles of TILE² pixels of V photographs, in random order.

    Rays of a tile meet the same voxels, which are read once then; what is learned is as good as from single rays.
    """

    def __init__(self, dataset: RayDataset, rng: np.random.Generator) -> None:
        # int64 [V]: ray of the photograph's first pixel, and its size
        self.first, self.width = (np.asarray(array, np.int64) for array in (dataset.first, dataset.width))
        self.rows = np.diff(self.first, append=dataset.count) // self.width
        counts = -(-self.width // TILE) * -(-self.rows // TILE)
        self.begins = np.cumsum(counts) - counts  # int64 [V]: number of the photograph's first tile
        self.numbers = rng.permutation(counts.sum())  # int64 [N]: tiles in the order in which they are taken

    def rays(self, start: int, count: int, apart: int = 1) -> np.ndarray:
        """Ray ids int32 [count, N] of so many tiles from the start-th on, of pixels so far apart; -1 beyond the photograph."""
        number = self.numbers[start : start + count]
        view = np.searchsorted(self.begins, number, side="right") - 1
        row, column = np.divmod(number - self.begins[view], -(-self.width[view] // TILE))
        y, x = (part.ravel() for part in np.mgrid[0:TILE:apart, 0:TILE:apart])
        y, x = (row * TILE)[:, None] + y, (column * TILE)[:, None] + x
        ids = self.first[view, None] + y * self.width[view, None] + x
        return np.where((y < self.rows[view, None]) & (x < self.width[view, None]), ids, -1).astype(np.int32)


def meeting(marcher: PackMarcher, tiles: Tiles, most: int, on_share: OnShare = lambda share: None) -> np.ndarray:
    """The first `most` rays of tiles that meet content, by a quarter of their rays."""
    found, count = [np.zeros(0, np.int32)], 0
    for start in range(0, len(tiles.numbers), PROBED):
        few = tiles.rays(start, PROBED, apart=2)
        meets = few >= 0
        meets[meets] = marcher.meets(few[meets])
        rays = tiles.rays(start, PROBED)[meets.any(1)]
        found.append(rays[rays >= 0])
        count += len(found[-1])
        on_share(max(count / most, start / len(tiles.numbers)))
        if count >= most:
            break
    return np.concatenate(found)[:most]
