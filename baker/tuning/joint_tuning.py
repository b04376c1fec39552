"""Voxels and view MLP tuned together, on exactly what the viewer shows (beyond SNeRG section 5.5).

The paper trains the view MLP on against the grid as quantising left it. Here the grid moves, too: every step takes the viewer's
own samples of some training rays from the voxels *as rounded to 8 bits*, and its gradient moves what is behind them (a
straight-through estimator).

A voxel of a fine grid is met by a handful of rays, and learns their noise by heart. So the voxels of a cell of a few voxels a
side move together: each cell adds to the straight colours and features of its voxels, and scales their density. For the same
reason Adam's denominator has a floor, the mean over all cells: what has hardly any gradient hardly moves.

    loss = mean over rays of |shown - photograph|²

In a step (Tuner), compiled loops march its rays through the stored atlas, JAX shades them and differentiates the loss, compiled
loops take the gradient back along the samples to the cells, and cells that moved are rounded and stored. Results do not depend on
the number of threads: sums are added in the order of the rays.

Notation: R rays of a step, in chunks of CHUNK; K cells, numbered from 1 in the grid's order (z slowest); row 0 of any table of
cells stands for what is empty.

The loop (joint_tune) decides which rays are taken, how many at once and for how long. All photographs are tuned on. Some held
back would not tell whether tuning helps: the field knows them by heart, and tuning on the others makes the pack forget them,
while it shows views that nobody trained on better.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from baker.tuning import cells
from baker.tuning.cells import BETAS, CHUNK, TINY, cells_of, work_for
from baker.tuning.marcher import LISTED, OnShare, PackMarcher, rays_in_grid
from baker.tuning.shading import ErrorTerms, Pixels, from_params, pixels_of, psnr_of, squared_error, to_params
from scenepack.codecs.quantisation import EXACT, Steps
from scenepack.pack import Pack
from training.dataset import RayDataset
from training.method import ViewMlpParams

PROBE_RAYS = 4096  # rays whose samples tell how many rays fill a step
PROBED = 96  # mean number of contributing samples a ray that the probe allocates for
SPARE = 2.0  # allocated contributing samples over their mean, since chunks differ
PART = 8192  # cells that a worker claims
STORED = 512  # cells that a worker stores at once
ADAM = optax.scale_by_adam(*BETAS, eps=TINY)


class Tuner:
    """It works on the pack's own arrays, which must be writable: a second copy of an atlas of 1000³ is a gigabyte.

    cell: voxels a side of a cell. by_opacity: see ErrorTerms. rays: how many a step takes; known once `fill` was called.
    """

    def __init__(self, pack: Pack, dataset: RayDataset, cell: int, *, by_opacity: bool = False) -> None:
        self.terms = ErrorTerms(dataset.background, pack.ndc, by_opacity)
        features = None if pack.atlas_features is None else np.ascontiguousarray(pack.atlas_features)
        self.pack = replace(pack, atlas_rgba=np.ascontiguousarray(pack.atlas_rgba), atlas_features=features)
        self.dataset, self.marcher = dataset, PackMarcher(self.pack, dataset)
        self.tables, self.workers = self.marcher.tables, self.marcher.workers
        self.cells = cells_of(pack, self.tables, cell)
        count = self.cells.occupied + 1
        self.delta, self.first, self.second, self.slopes = (np.zeros((count, 8), np.float32) for _ in range(4))
        self.met = np.zeros(count, np.uint8)
        self.sums = np.zeros((-(-count // PART), 2, 8))  # see baker.tuning.cells.move_moments
        self.head: Any = pack.view_mlp and to_params(pack.view_mlp)
        self.head_moments: Any = ADAM.init(self.head)
        self.steps = EXACT.channels
        self.rays, self.work = 0, work_for(0, 0)

    def round_to(self, steps: Steps) -> None:
        """Stores everything in multiples of `steps`, now and after each update."""
        self.steps = steps.channels
        self._store(np.arange(1, self.cells.occupied + 1, dtype=np.int32))

    def fill(self, ids: np.ndarray, samples: int, seed: int) -> None:
        """Sets `rays`, so that a step on such rays takes about so many samples."""
        probe = np.resize(np.random.default_rng(seed).permutation(ids)[:PROBE_RAYS], PROBE_RAYS)
        self.rays, self.work = PROBE_RAYS, work_for(PROBE_RAYS, CHUNK * PROBED)
        self._gather(probe)
        counts = np.diff(self.work.first, axis=1)
        capacity = int(SPARE * CHUNK * counts.mean()) + int(counts.max()) + LISTED
        each = max(self.work.supported.sum() / PROBE_RAYS, 1.0)
        self.rays = max(int(samples / each) // CHUNK, 1) * CHUNK
        self.work = work_for(self.rays, capacity)

    def update(self, ids: np.ndarray, rates: np.ndarray, count: int) -> None:
        """One step of Adam on the rays `ids` int32 [rays]; rates float32 [9]: of the 8 parts of delta, and of the view MLP.
        count: steps so far."""
        slopes, head_slope = _slopes(self.head, self._gather(ids), terms=self.terms)
        self._follow(np.ascontiguousarray(slopes))
        bias_correction = np.sqrt(1 - BETAS[1] ** (count + 1)) / (1 - BETAS[0] ** (count + 1))
        self._move(rates[:8] * np.float32(bias_correction))
        self.head, self.head_moments = _moved_head(self.head, head_slope, self.head_moments, rates[8])

    def score(self, ids: np.ndarray) -> tuple[float, float]:
        """(PSNR of the clamped picture, contributing samples a ray) over the rays `ids`."""
        error = weight = rays = samples = 0.0
        for start in range(0, len(ids), self.rays):
            some = ids[start : start + self.rays]
            pixels = self._gather(np.resize(some, self.rays))
            counts = self.work.whole & (np.arange(self.rays) < len(some))
            own = _error(self.head, pixels._replace(whole=jnp.asarray(counts)), terms=self.terms)
            error, weight, rays = error + float(own[0]), weight + float(own[1]), rays + np.count_nonzero(counts)
            samples += np.diff(self.work.first, axis=1).ravel()[counts].sum()
        return psnr_of(error, weight), float(samples / max(rays, 1.0))

    def tuned(self) -> Pack:
        """The pack with its voxels and view MLP as the updates so far left them."""
        return self.pack if self.head is None else replace(self.pack, view_mlp=from_params(self.head))

    def _gather(self, ids: np.ndarray) -> Pixels:
        """Fills the work's samples and sums of rays `ids` [rays]."""
        rays = rays_in_grid(self.marcher.box, self.marcher.rays, ids)
        tables, found, work = self.tables, self.marcher.found, self.work
        self.workers.share_range(
            self.rays, CHUNK,
            lambda worker, low, high: cells.gather_chunk(tables, rays, low // CHUNK, low, high, found[worker], work),
        )  # fmt: skip
        return pixels_of(self.dataset, ids, work.sums)._replace(whole=jnp.asarray(work.whole))

    def _follow(self, slopes: np.ndarray) -> None:
        """From slopes of sums to slopes of cells."""
        parts = self.tables, self.cells, cells.LOG_DENSITY, slopes
        self.workers.share_range(
            self.rays, CHUNK, lambda _, low, high: cells.slope_chunk(*parts, low // CHUNK, low, high, self.work)
        )
        ends = np.linspace(1, self.cells.occupied + 1, self.workers.count + 1).astype(np.int64)
        sums = self.work, self.slopes, self.met
        self.workers.share(self.workers.count, lambda _, part: cells.add_slopes(*sums, ends[part], ends[part + 1]))

    def _move(self, rates: np.ndarray) -> None:
        """A step of Adam on the cells that were met, stored."""
        moments = self.slopes, self.met, self.first, self.second, self.sums
        self.workers.share_range(
            self.cells.occupied + 1, PART, lambda _, low, high: cells.move_moments(*moments, low // PART, low, high)
        )
        total, ever = self.sums.sum(0)
        floor = np.sqrt(total / np.maximum(ever, 1)).astype(np.float32)
        some = np.flatnonzero(self.met).astype(np.int32)
        self.met[:] = 0
        moved = self.delta, self.slopes, self.first, self.second, floor, rates, some
        self.workers.share_range(len(some), PART, lambda _, low, high: cells.move_cells(*moved, low, high))
        self._store(some)

    def _store(self, some: np.ndarray) -> None:
        stored = self.cells, cells.DEPTHS, self.delta, self.steps, some, self.tables.rgba, self.tables.features
        self.workers.share_range(len(some), STORED, lambda _, low, high: cells.store_cells(*stored, low, high))


@jax.jit
def _moved_head(head: Any, slope: Any, moments: optax.OptState, rate: jax.Array) -> tuple[Any, optax.OptState]:
    """The view MLP, or None, after a step of Adam, and its moments."""
    moves, moments = ADAM.update(slope, moments)
    return jax.tree.map(lambda value, move: value - rate * move, head, moves), moments


_error = jax.jit(partial(squared_error, clamped=True), static_argnames="terms")


@partial(jax.jit, static_argnames="terms")
def _slopes(head: ViewMlpParams | None, pixels: Pixels, terms: ErrorTerms) -> tuple[jax.Array, ViewMlpParams | None]:
    """Slopes of the mean loss with respect to sums, [R, 8], and to the view MLP."""

    def loss_of(sums: jax.Array, head: ViewMlpParams | None) -> jax.Array:
        error, weight = squared_error(head, pixels._replace(sums=sums), terms, clamped=False)
        return error / jnp.maximum(weight, 1.0)

    return jax.grad(loss_of, argnums=(0, 1))(pixels.sums, head)


# --- The loop ---

SCORED_RAYS = 65_536
TILE, TILES_TOGETHER = 4, 16_384  # pixels a side; tiles that are looked at together
# Small cells are sharper where enough rays meet each; cells of one voxel learn the training views by heart.
RAYS_PER_CELL, NARROWEST, WIDEST = 6, 2, 4
MOST_CELLS = 1 << 27  # of a grid, empty ones included: a table of all of them is kept
LEAST_STEPS, FEWEST_SAMPLES = 200, 32_768
CHOOSING = 0.05  # of the time: which tiles meet content
FINAL_RATE = 0.05  # the rates fall log-linearly to this share


@dataclass(frozen=True)
class JointConfig:
    passes: float = 1.3  # over the training rays that meet content
    most_steps: int = 2000  # fewer passes where they would take more: every ray of an indoor scene meets content
    samples: int = 393_216  # marched a step; rays are as many as fill them
    rate: float = 1.0  # Adam's learning rate of straight colours and features at the start, in units of 1/255
    density_rate: float = 0.06  # of a cell's log density
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
    marcher, tiles = PackMarcher(pack, dataset), _Tiles(dataset, np.random.default_rng(config.seed))
    probed = tiles.rays(0, TILES_TOGETHER)
    probed = probed[probed >= 0]
    probe = probed[marcher.meets(probed)]
    if not len(probe):
        return pack, {}
    meet = round(len(tiles.numbers) * TILE**2 * len(probe) / len(probed))  # about so many rays meet content
    tuner = Tuner(pack, dataset, _cell_for(pack, meet), by_opacity=by_opacity)
    tuner.fill(probe, config.samples, config.seed)
    steps = config.passes * meet / tuner.rays
    if steps < LEAST_STEPS:  # of few rays there are more steps, each with fewer
        tuner.fill(probe, max(int(config.samples * steps / LEAST_STEPS), FEWEST_SAMPLES), config.seed)
        steps = config.passes * meet / tuner.rays
    steps = min(max(int(steps), 1), config.most_steps)
    trained_on = _meeting(marcher, tiles, steps * tuner.rays, lambda share: on_share(CHOOSING * share, "choosing rays"))
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
    pixels = pixels_of(dataset, ids, PackMarcher(pack, dataset).accumulate(ids))
    terms, head = ErrorTerms(dataset.background, pack.ndc, by_opacity), pack.view_mlp and to_params(pack.view_mlp)
    return psnr_of(*_error(head, pixels, terms=terms))


def _cell_for(pack: Pack, rays: int) -> int:
    """Voxels a side of the cells that suit a pack which so many training rays meet: surfaces have a cell for cell² voxels."""
    voxels = int(np.count_nonzero(pack.atlas_rgba[..., 3]))
    cell = min(round(float(np.sqrt(RAYS_PER_CELL * voxels / max(rays, 1)))), WIDEST)
    return max(cell, NARROWEST, int(np.ceil((np.prod(pack.grid_size, dtype=float) / MOST_CELLS) ** (1 / 3))))


class _Tiles:
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


def _meeting(marcher: PackMarcher, tiles: _Tiles, most: int, on_share: OnShare) -> np.ndarray:
    """The first `most` rays of tiles that meet content, by a quarter of their rays."""
    found, count = [np.zeros(0, np.int32)], 0
    for start in range(0, len(tiles.numbers), TILES_TOGETHER):
        few = tiles.rays(start, TILES_TOGETHER, apart=2)
        meets = few >= 0
        meets[meets] = marcher.meets(few[meets])
        rays = tiles.rays(start, TILES_TOGETHER)[meets.any(1)]
        found.append(rays[rays >= 0])
        count += len(found[-1])
        on_share(max(count / most, start / len(tiles.numbers)))
        if count >= most:
            break
    return np.concatenate(found)[:most]
