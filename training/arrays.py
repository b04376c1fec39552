"""Trees of arrays as flat dictionaries of named arrays, the form in which checkpoints hold them.

A leaf's name is its path in the tree, "params/fine/field/0/weight": field names, keys and indices joined
by "/".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from console import UserError

Tree = TypeVar("Tree")


def named_leaves(tree: Any) -> dict[str, Any]:
    """The leaves of a tree by their names."""
    return {_name(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(tree)}


def to_arrays(tree: Any) -> dict[str, np.ndarray]:
    """Copies a tree's leaves to the host, by name."""
    return {name: np.asarray(leaf) for name, leaf in jax.device_get(named_leaves(tree)).items()}


def from_arrays(template: Tree, arrays: Mapping[str, np.ndarray], where: str = "checkpoint") -> Tree:
    """The tree of the template's structure with the named arrays as leaves, on the device.

    template: a tree of arrays or of jax.ShapeDtypeStruct. UserError where a name is missing or an array's
    shape or type is another.
    """
    leaves = []
    for path, expected in jax.tree_util.tree_leaves_with_path(template):
        name = _name(path)
        if name not in arrays:
            raise UserError(f'no array "{name}"', where=where, remedy="the file belongs to another configuration")
        found = arrays[name]
        if tuple(found.shape) != tuple(expected.shape) or found.dtype != expected.dtype:
            raise UserError(
                f'array "{name}" does not fit',
                where=where,
                expected=f"{expected.dtype} {list(expected.shape)}",
                found=f"{found.dtype} {list(found.shape)}",
                remedy="the file belongs to another configuration",
            )
        leaves.append(jnp.asarray(found))
    return jax.tree_util.tree_unflatten(jax.tree_util.tree_structure(template), leaves)


def _name(path: tuple[Any, ...]) -> str:
    parts = []
    for entry in path:
        for attribute in ("name", "key", "idx"):
            if hasattr(entry, attribute):
                parts.append(str(getattr(entry, attribute)))
                break
    return "/".join(parts)
