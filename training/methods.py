"""The registry of methods: which class stands behind the name in TrainConfig.method."""

from __future__ import annotations

from dataclasses import replace

from console import UserError
from training.config import TrainConfig
from training.dataset import RayDataset
from training.method import Method


def make_method(config: TrainConfig, dataset: RayDataset) -> Method:
    """The method that config names, for the rays of a dataset; its modules are imported only when asked for."""
    if config.method == "nerf":
        if config.exposure == "on":
            remedy = "use --preset quick, normal or full"
            raise UserError("is fitted by the method multires only", where="--exposure on", remedy=remedy)
        from training.nerf.method import NerfMethod

        return NerfMethod(config, dataset)
    if config.method == "multires":
        from training.multires.method import MultiresMethod

        return MultiresMethod(config, dataset)
    raise UserError("no such method", where="method", expected="nerf or multires", found=config.method)


def settled(config: TrainConfig) -> TrainConfig:
    """The config of a run that begins here, with what this machine decides: a run keeps its engine wherever it goes on."""
    if config.method == "nerf":
        return replace(config, engine="jax")
    from training.multires.engines import chosen_engine

    return replace(config, engine=chosen_engine(config.engine))
