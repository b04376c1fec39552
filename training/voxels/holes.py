"""Closing holes: what no photograph shows, and views between photographs would look through.

Nothing tells what is where no photograph looks, under a vehicle or behind a lever. No loss asks for voxels there, and pruning
drops them: the next view looks into the hollow inside and through it to the background, in white specks that nobody expects.

So the cells that photographs look into are marked: all that a ray passes before half of its light is gone. Then views between
photographs look (training.views_between). A ray of theirs that reaches the background through cells that no photograph looks
into is a hole in the picture where no ray beside it reaches the background through cells that are known to be empty: beside a
silhouette there may well be nothing, but amid surfaces there is hardly a hole. The first such cells on its way are walled up,
in the colours of what is around them, if they touch something solid. Photographs do not see these walls, so that training
leaves them alone; where one does after all, the steps to come may take the wall away again.

Notation: cells [z, y, x] of `side` voxels.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from console import Progress, progress
from training.dataset import RayDataset
from training.devices import agree, is_writer
from training.marching.rays import GridRays, to_grid
from training.method import Rays
from training.views_between import with_views_between
from training.voxels.coverage import views_that_see
from training.voxels.engine import Engine
from training.voxels.settings import Plan, Settings
from training.voxels.sparse_grid import GridLayout, Occupancy, build_layout, dilate
from training.voxels.state import Trainable, VoxelState, state_over

CELLS = 256  # along the longest side of the grid, at most
LATTICE = 200  # rays along the longer side of a picture
NEIGHBOURS = 2  # photographs with which each has a view between
SOLID = 0.5  # opacity of a ray that meets something
MARGIN = 1.0  # voxels before what a ray meets that count as part of it
DEEP = 4  # half cells that a wall is deep, at least
WIDER = 2  # cells that walls are grown by, so that rays between those of the lattice meet them, too
WALL = 0.9  # opacity of a voxel of a wall
COLOURED = 0.2  # opacity from which a voxel's colour counts
PASSES = 64  # voxels that colours spread, at most


class Lines(NamedTuple):
    """What a view sees, along the rays of a lattice: origins, directions [N, 3], start, end [N] in grid coordinates; meets bool
    [N], and the voxels along each ray to where it does, stop [N] (its end where it meets nothing); rows of the lattice."""

    origins: np.ndarray
    directions: np.ndarray
    start: np.ndarray
    end: np.ndarray
    meets: np.ndarray
    stop: np.ndarray
    rows: int


def close_holes(engine: Engine, state: Any, geometry: RayDataset, plan: Plan, settings: Settings) -> Any:
    """An engine's state, `closed`: with walls where views between photographs find holes, if there are any.

    geometry: the dataset on one device of this process (RayDataset.local).
    """
    occupancy, loops = engine.occupancy(state), _loops()
    walls = np.zeros(0, bool)
    if loops is not None:
        side = -(-max(occupancy.present.shape) // CELLS)
        views = with_views_between(geometry, NEIGHBOURS)
        with progress("closing holes", views.views, quiet=not is_writer()) as bar:
            walls = _walls(engine, state, views, geometry.views, occupancy, side, loops, bar)
        walls = walls & _covered(geometry, occupancy, walls.shape, side, plan.least_views)
    plain = engine.end(state)
    if walls.any():
        solid = _opacity(np.asarray(plain.trainable.rows)[1:], occupancy.voxel, settings) >= SOLID
        walls = attached(walls, _cells_of(occupancy.present, solid, side))
    if walls.any():
        for axis in range(3):
            walls = np.repeat(walls, side, axis)
        walls = walls[tuple(slice(n) for n in occupancy.present.shape)]
        plain = _walled(plain, occupancy, walls, settings)
    return engine.begin(plain._replace(closed=True))


def _loops() -> ModuleType | None:
    """The compiled loops; None where Numba is missing."""
    if importlib.util.find_spec("numba") is None:
        return None
    return importlib.import_module("training.voxels.fused.carving")


def _walls(
    engine: Engine, state: Any, views: RayDataset, photographs: int, occupancy: Occupancy, side: int, loops: ModuleType,
    bar: Progress,
) -> np.ndarray:  # fmt: skip
    """bool cells that are to be walled up. views: the photographs, and those between them."""
    shape, wide = tuple(-(-n // side) for n in occupancy.present.shape), np.float32(side)
    seen = np.zeros(shape, bool)
    for lines in _looks(engine, state, views, occupancy, range(photographs)):
        before = np.where(lines.meets, lines.stop - np.float32(MARGIN), lines.end)
        loops.carve(seen, wide, lines.origins, lines.directions, lines.start, before)
        bar.advance()
    walls = np.zeros(shape, bool)
    for lines in _looks(engine, state, views, occupancy, range(photographs, views.views)):
        enters = np.zeros(len(lines.meets), bool)
        loops.enter(seen, wide, lines.origins, lines.directions, lines.start, lines.stop, enters)
        hole = holes_of(lines.meets.reshape(lines.rows, -1), enters.reshape(lines.rows, -1)).ravel()
        some = (np.ascontiguousarray(a[hole]) for a in lines[:3])
        loops.block(seen, wide, *some, lines.stop[hole], walls, DEEP)
        bar.advance()
    for _ in range(WIDER):
        walls = dilate(walls) & ~seen
    return agree(walls)  # processes that differ in the last bit would close other holes


def _covered(
    geometry: RayDataset, occupancy: Occupancy, shape: tuple[int, ...], side: int, least_views: int
) -> np.ndarray:
    """bool cells that enough photographs look towards; others were left out of the scene from the start."""
    if least_views < 2:
        return np.ones(shape, bool)
    seen = views_that_see(geometry, _box(occupancy.origin, occupancy.voxel * side, shape))
    return seen >= least_views


def _box(origin: np.ndarray, voxel: np.ndarray, shape: tuple[int, ...]) -> GridLayout:
    """The layout of a box of so many voxels, none of which is there: all that rays need to know of it."""
    layout = build_layout(np.zeros((1, 1, 1), bool), origin, voxel)
    return layout._replace(dims=jnp.asarray(shape[::-1], jnp.int32))


def _cells_of(present: np.ndarray, chosen: np.ndarray, side: int) -> np.ndarray:
    """bool cells with a chosen voxel; chosen bool [V] of those that are present."""
    cells = np.zeros([-(-n // side) for n in present.shape], bool)
    cells[tuple(place[chosen] // side for place in np.nonzero(present))] = True
    return cells


def attached(walls: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """The pieces of walls that touch something solid; both bool cells. What hangs in the air closes no hole."""
    pieces = _pieces(walls)
    touching = np.unique(pieces[dilate(solid) & walls])
    return walls & np.isin(pieces, touching)


def holes_of(meets: np.ndarray, enters: np.ndarray) -> np.ndarray:
    """bool [rows, columns] of a picture: which rays look through a hole. meets: those that meet something; enters: those that
    pass cells which no photograph looks into."""
    through = ~meets & enters
    empty = np.pad(~meets & ~enters, 1, constant_values=True)  # nobody knows what is beyond the picture's edge
    beside_empty = ndimage.binary_dilation(empty, np.ones((3, 3))).astype(bool)[1:-1, 1:-1]
    pieces = _pieces(through)
    return through & ~np.isin(pieces, np.unique(pieces[beside_empty]))


def _pieces(where: np.ndarray) -> np.ndarray:
    """int32, like `where`: the number of the piece that each place belongs to, from 1; 0 elsewhere. Corners join, too."""
    labelled: Any = ndimage.label(where, np.ones([3] * where.ndim))  # whose stubs know of a count alone, too
    return labelled[0]


def _looks(engine: Engine, state: Any, views: RayDataset, occupancy: Occupancy, numbers: range) -> Iterator[Lines]:
    """What views see, one after the other."""
    present, origin, voxel = occupancy
    box = _box(origin, voxel, present.shape)
    first, width = np.asarray(views.first, np.int64), np.asarray(views.width, np.int64)
    height = np.diff(np.append(first, views.count)) // width * views.facts.row_step
    for view in numbers:
        apart = max(max(width[view], height[view]) // LATTICE, 1)
        random = np.random.default_rng(view)
        counts = (
            max(n // apart, 1) for n in (width[view], height[view])
        )  # the same for each, so that JAX compiles once
        x, y = (random.integers(0, apart) + apart * np.arange(count) for count in counts)
        columns, rows = (jnp.asarray(a.ravel(), jnp.float32) for a in np.meshgrid(x, y))
        rays, grid = _rays(views, box, jnp.int32(view), columns, rows)
        shown = engine.render(state, rays)
        meets = np.asarray(shown.alpha) >= SOLID
        origins, directions, start, end = (np.asarray(a) for a in (grid.origins, grid.directions, grid.start, grid.end))
        stop = np.where(meets, np.asarray(shown.depth * grid.scale), end)
        yield Lines(origins, directions, start, end, meets, stop.astype(np.float32), len(y))


@jax.jit
def _rays(
    views: RayDataset, box: GridLayout, view: jax.Array, columns: jax.Array, rows: jax.Array
) -> tuple[Rays, GridRays]:
    """Rays through columns and rows [N] of a view, and the same in the box."""
    rays = views.rays(jnp.full(columns.shape, view), columns, rows)
    return rays, to_grid(box, rays)


def _walled(state: VoxelState, occupancy: Occupancy, walls: np.ndarray, settings: Settings) -> VoxelState:
    """A state with opaque voxels in all of `walls` bool [z, y, x], whose moments begin anew."""
    before, origin, voxel = occupancy
    present = before | walls
    numbers = np.zeros(before.shape, np.int32)
    numbers[before] = np.arange(1, np.count_nonzero(before) + 1, dtype=np.int32)
    kept = np.concatenate([[0], numbers[present]])  # the row that each voxel had; 0, which is blank, for a new one
    del numbers
    layout = build_layout(present, origin, voxel)
    rows = np.asarray(state.trainable.rows)[kept]
    made = np.concatenate([[False], walls[present]]) & (_opacity(rows, voxel, settings) < WALL)
    coloured = (_opacity(rows, voxel, settings) >= COLOURED) & ~made
    coloured[0] = False
    _spread_colours(rows, np.flatnonzero(made), coloured, np.asarray(layout.lookup), np.asarray(layout.dims))
    rows[made, 0] = _raw_density(WALL, voxel, settings)
    parts = [Trainable(jnp.asarray(rows), state.trainable.head)]
    for moments in (state.first, state.second):
        moved = np.asarray(moments.rows)[kept]
        moved[made] = 0
        parts.append(Trainable(jnp.asarray(moved), moments.head))
    walled = state_over(layout, (parts[0], parts[1], parts[2]), state.updates, 0, state.step_voxels, state.gains)
    return walled._replace(hits=state.hits, hit_count=state.hit_count)


def _opacity(rows: np.ndarray, voxel: np.ndarray, settings: Settings) -> np.ndarray:
    """float32 [V + 1]: opacity of a way through each voxel."""
    density = np.logaddexp(np.float32(0), rows[:, 0] + np.float32(settings.shift)) / np.float32(settings.reference)
    return 1 - np.exp(-density * np.float32(voxel.max()))


def _raw_density(opacity: float, voxel: np.ndarray, settings: Settings) -> float:
    """The raw value of voxels of that opacity: the inverse of _opacity."""
    return float(np.log(np.expm1(-np.log1p(-opacity) / voxel.max() * settings.reference))) - settings.shift


def _spread_colours(
    rows: np.ndarray, blank: np.ndarray, coloured: np.ndarray, lookup: np.ndarray, dims: np.ndarray
) -> None:
    """Gives blank rows int [N] of [V + 1, 8] the mean colours and features of the coloured voxels around them, layer by layer;
    where there are none, of all. coloured bool [V + 1]: also set where a row gets some."""
    width, height = int(dims[0]) + 2, int(dims[1]) + 2
    (cells,) = np.nonzero(lookup)
    around = [(z * height + y) * width + x for z in (-1, 0, 1) for y in (-1, 0, 1) for x in (-1, 0, 1)]
    mean = rows[coloured, 1:].mean(0) if coloured.any() else np.zeros(rows.shape[1] - 1, np.float32)
    for _ in range(PASSES):
        if not len(blank):
            return
        total, count = np.zeros((len(blank), rows.shape[1] - 1), np.float32), np.zeros(len(blank), np.float32)
        for offset in around:
            beside = lookup[cells[blank - 1] + offset]
            counts = coloured[beside]
            total += rows[beside, 1:] * counts[:, None]
            count += counts
        reached = count > 0
        if not reached.any():
            break
        rows[blank[reached], 1:] = total[reached] / count[reached, None]
        coloured[blank[reached]] = True
        blank = blank[~reached]
    rows[blank, 1:] = mean
