"""The loop around baker.tuning.tuner.Tuner: which rays, how many at once, for how long, which state is kept."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from baker.tuning.marcher import OnShare, PackMarcher
from baker.tuning.shading import Accumulated, ErrorTerms, ShadingInputs, psnr_of, squared_error, to_params
from baker.tuning.tuner import Tuner
from scenepack.codecs.quantisation import EXACT, Steps
from scenepack.pack import Pack
from training.dataset import RayDataset

HELD_OUT_RAYS = 65_536
TILE, PROBED = 4, 16_384  # pixels a side; tiles that are looked at together
# Small cells are sharper where enough rays meet each; cells of one voxel learn the training views by heart.
RAYS_PER_CELL, NARROWEST, WIDEST = 6, 2, 4
MOST_CELLS = 1 << 27  # of a grid, empty ones included: a table of all of them is kept
LEAST_STEPS, FEWEST_SAMPLES = 200, 32_768
CHOOSING = 0.15  # of the time: which rays meet content


@dataclass(frozen=True)
class JointConfig:
    """How to fine-tune voxels and view MLP together."""

    passes: float = 1.3
    """Passes over the training rays that meet content."""
    most_steps: int = 1100
    """Fewer passes where they would take more steps than this: every ray of a room meets content."""
    samples: int = 393_216
    """Samples marched a step; rays are as many as fill them."""
    cell: int | None = None
    """Voxels a side of the cells that move together. None: NARROWEST to WIDEST, such that RAYS_PER_CELL rays meet a cell."""
    rate: float = 1.0
    """Adam's learning rate of straight colours and features at the start, in units of 1/255."""
    density_rate: float = 0.03
    """Adam's learning rate of a cell's log density at the start."""
    head_rate: float = 1e-3
    """Adam's learning rate of the view MLP at the start."""
    final_rate_factor: float = 0.05
    """The rates fall log-linearly to this share."""
    held_out: int = 10
    """One training view in so many tells which state is best, and is not trained on; 0 trains on all, to the end."""
    stop_below_db: float = 0.4
    """Ends where held-out views are so much below their best. From a check to the end, four captures gained at most 0.31 dB."""
    steps: Steps = EXACT
    """What is stored in multiples of."""
    checks: int = 8
    """How often the held-out views are looked at."""
    seed: int = 0


def joint_tune(
    pack: Pack, dataset: RayDataset, config: JointConfig, on_share: Callable[[float, str], None] = lambda share, text: None,
    by_opacity: bool = False,
) -> tuple[Pack, dict[str, Any]]:  # fmt: skip
    """The pack with voxels and view MLP refined; figures, of held-out rays before and after. The arrays of `pack` are changed.
    The state is kept in which held-out views look best.

    by_opacity: see baker.tuning.shading.ErrorTerms. If no training ray meets the pack, it is returned unchanged, without figures.
    """
    rng, away = np.random.default_rng(config.seed), held_out_views(dataset, config.held_out)
    marcher, tiles = PackMarcher(pack, dataset), tiles_of(dataset, ~away, rng)
    probed = tiles.rays(0, PROBED)
    probe = probed[marcher.meets(probed)]
    if not len(probe):
        return pack, {}
    meet = round(len(tiles.numbers) * TILE**2 * len(probe) / len(probed))  # about so many rays meet content
    held_out = meeting(marcher, tiles_of(dataset, away if away.any() else ~away, rng), HELD_OUT_RAYS)
    tuner = Tuner(pack, dataset, config.cell or cell_for(pack, meet), by_opacity=by_opacity)
    tuner.fill(probe, config.samples, config.seed)
    steps = config.passes * meet / tuner.rays
    if steps < LEAST_STEPS:  # of few rays there are more steps, each with fewer
        tuner.fill(probe, max(int(config.samples * steps / LEAST_STEPS), FEWEST_SAMPLES), config.seed)
        steps = config.passes * meet / tuner.rays
    steps = min(max(int(steps), 1), config.most_steps)
    trained_on = meeting(marcher, tiles, steps * tuner.rays, lambda share: on_share(CHOOSING * share, "choosing rays"))
    on_share(CHOOSING, "compiling")
    before = best = now = tuner.score(held_out)
    if config.steps != EXACT:
        tuner.round_to(config.steps)
        best = now = tuner.score(held_out)
    kept, done = tuner.snapshot(), 0
    colour = config.rate / 255
    rates = np.array([*[colour] * 3, config.density_rate, *[colour] * 4, config.head_rate], np.float32)
    check_every = max(steps // config.checks, 1)
    for step in range(steps):
        decay = config.final_rate_factor ** (step / steps)
        ids = trained_on.take(np.arange(step * tuner.rays, (step + 1) * tuner.rays), mode="wrap")
        tuner.update(ids, rates * np.float32(decay), step)
        done = step + 1
        if done % check_every == 0 or done == steps:
            now = tuner.score(held_out)
            if now[0] >= best[0] or not config.held_out:
                best, kept = now, tuner.snapshot()
            elif now[0] < best[0] - config.stop_below_db:
                break
        on_share(
            CHOOSING + (1 - CHOOSING) * done / steps,
            f"step {done} of {steps}, {'held-out ' if config.held_out else ''}{now[0]:.2f} dB",
        )
    return tuner.tuned(kept), {
        "passes": round(done * tuner.rays / meet, 2),
        "held_out_psnr_before": round(before[0], 3), "held_out_psnr_after": round(best[0], 3),
        "samples_a_ray_before": round(before[1], 2), "samples_a_ray_after": round(best[1], 2),
    }  # fmt: skip


def shown_psnr(pack: Pack, dataset: RayDataset, seed: int, *, by_opacity: bool = False) -> float:
    """PSNR (dB) of what the viewer shows of the pack, over a random HELD_OUT_RAYS of the training rays."""
    ids = np.sort(np.random.default_rng(seed).permutation(dataset.count)[:HELD_OUT_RAYS]).astype(np.int32)
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


def held_out_views(dataset: RayDataset, one_in: int) -> np.ndarray:
    """bool [V]: every one_in-th view; none where there are fewer, or one_in is 0."""
    views = np.arange(dataset.views)
    return views % one_in == one_in // 2 if one_in and dataset.views >= one_in else np.zeros(dataset.views, bool)


class Tiles(NamedTuple):
    """Tiles of TILE² pixels of V photographs. Rays of a tile meet the same voxels, which are read once then; what
    is learned is as good as from single rays.

    first, width, rows int64 [V]: ray of the photograph's first pixel, and its size. begins int64 [V]: its first tile's number.
    numbers int64 [N]: tiles in the order in which they are taken.
    """

    first: np.ndarray
    width: np.ndarray
    rows: np.ndarray
    begins: np.ndarray
    numbers: np.ndarray

    def rays(self, start: int, count: int) -> np.ndarray:
        """Ray ids int32 of so many tiles from the start-th on."""
        number = self.numbers[start : start + count]
        view = np.searchsorted(self.begins, number, side="right") - 1
        row, column = np.divmod(number - self.begins[view], -(-self.width[view] // TILE))
        y = (row * TILE)[:, None] + np.repeat(np.arange(TILE), TILE)
        x = (column * TILE)[:, None] + np.tile(np.arange(TILE), TILE)
        ids = self.first[view, None] + y * self.width[view, None] + x
        return ids[(y < self.rows[view, None]) & (x < self.width[view, None])].astype(np.int32)


def tiles_of(dataset: RayDataset, views: np.ndarray, rng: np.random.Generator) -> Tiles:
    """All tiles of the photographs `views` bool [V], in random order."""
    first, width = (np.asarray(array, np.int64) for array in (dataset.first, dataset.width))
    rows = np.diff(first, append=dataset.count) // width
    first, width, rows = first[views], width[views], rows[views]
    counts = -(-width // TILE) * -(-rows // TILE)
    return Tiles(first, width, rows, np.cumsum(counts) - counts, rng.permutation(counts.sum()))


def meeting(marcher: PackMarcher, tiles: Tiles, most: int, on_share: OnShare = lambda share: None) -> np.ndarray:
    """The first `most` rays of tiles that meet content."""
    found, count = [np.zeros(0, np.int32)], 0
    for start in range(0, len(tiles.numbers), PROBED):
        rays = tiles.rays(start, PROBED)
        found.append(rays[marcher.meets(rays)])
        count += len(found[-1])
        on_share(max(count / most, start / len(tiles.numbers)))
        if count >= most:
            break
    return np.concatenate(found)[:most]
