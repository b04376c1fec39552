"""Geometry is computed in float32 on every card: products ask for the highest precision, where NVIDIA's default is TF32.

Read in the programs themselves, so that no card is needed.
"""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from baker.baking.grid import make_grid
from baker.tuning import marcher
from baker.tuning.pruning import arriving_transmittance
from tests.baker.analytic import ball, culled
from tests.baker.baking.test_grid_and_culling import baked
from tests.scenepack.random_packs import BLENDER_FRAME
from training.dataset import RayDataset

GRID = make_grid(np.full(3, -0.9), np.full(3, 0.9), 60, 30, BLENDER_FRAME)


def precisions(program: str) -> list[str]:
    """Of each product of a program (StableHLO text): the precision asked of its first operand."""
    products = re.findall(r"stablehlo\.dot_general.*", program)
    return [(re.search(r"precision = \[(\w+), \w+\]", product) or [product, "DEFAULT"])[1] for product in products]


def test_the_products_that_make_training_rays_ask_for_the_highest_precision(dataset: RayDataset) -> None:
    rays_at = jax.jit(lambda dataset, ids: dataset.rays_at(ids))
    assert precisions(rays_at.lower(dataset, jnp.arange(8, dtype=jnp.int32)).as_text()) == ["HIGHEST"]


def test_so_do_those_of_culling_and_pruning(dataset: RayDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    programs, function = [], marcher._in_grid

    def recorded(*arguments):
        programs.append(function.lower(*arguments).as_text())
        return function(*arguments)

    monkeypatch.setattr(marcher, "_in_grid", recorded)
    culling = culled(ball, GRID, dataset)
    first = len(programs)
    arriving_transmittance(baked(culling, GRID), dataset, 0)
    assert len(programs) > first > 0
    for program in programs:
        assert len(precisions(program)) >= 3, "rays are made, and moved into the grid's frame"
        assert set(precisions(program)) == {"HIGHEST"}
