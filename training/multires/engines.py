"""Which engine a run has: training.multires.engine.Engine by name, and the choice where a run begins."""

from __future__ import annotations

import importlib

import jax

from training.config import EngineName
from training.dataset import RayDataset
from training.multires.engine import Engine
from training.multires.settings import Plan, Settings


def make_engine(name: EngineName, dataset: RayDataset, plan: Plan, settings: Settings, seed: int) -> Engine:
    """The engine of a name."""
    if name == "jax":
        from training.multires.jax_engine import JaxEngine

        return JaxEngine(dataset, plan, settings, seed)
    fused = importlib.import_module("training.multires.fused.engine")
    return fused.FusedEngine(dataset, plan, settings, seed)
