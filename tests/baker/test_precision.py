"""Geometry is computed in float32 on every card: products ask for the highest precision, where NVIDIA's default is TF32.

Read in the programs themselves, so that no card is needed.
"""

import re
from types import ModuleType

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


def recorded(module: ModuleType, name: str, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The program of the jitted function `name` of a module, each time that it is called from now on."""
    programs, function = [], getattr(module, name)

    def call(*arguments):
        programs.append(function.lower(*arguments).as_text())
        return function(*arguments)

    monkeypatch.setattr(module, name, call)
    return programs


def test_the_products_that_make_training_rays_ask_for_the_highest_precision(dataset: RayDataset) -> None:
    program = (
        jax.jit(lambda dataset, ids: dataset.rays_at(ids)).lower(dataset, jnp.arange(8, dtype=jnp.int32)).as_text()
    )
    assert precisions(program) == ["HIGHEST"]


def test_so_do_those_of_culling_and_pruning(dataset: RayDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    programs = recorded(marcher, "_in_grid", monkeypatch)
    culling = culled(ball, GRID, dataset)
    first = len(programs)
    arriving_transmittance(baked(culling, GRID), dataset, 0)
    assert len(programs) > first > 0
    for program in programs:
        assert len(precisions(program)) >= 3, "rays are made, and moved into the grid's frame"
        assert set(precisions(program)) == {"HIGHEST"}
